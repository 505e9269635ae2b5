"""Compiled code is never stale, and works where nothing can be written."""

from __future__ import annotations

import ast
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from ltv_mpc import jit
from ltv_mpc.kernel_hash import kernel_hash

ROOT = Path(__file__).resolve().parents[2]

CALLEE = '''
from typing import NamedTuple

from ltv_mpc.jit import jit

GAIN = 2.0


class Pair(NamedTuple):
    first: float
    second: float


@jit
def inner(x):
    """Return a multiple."""
    return GAIN * x


@jit
def other(x):
    return x
'''

CALLER = """
from ltv_mpc import callee
from ltv_mpc.callee import Pair, inner
from ltv_mpc.jit import jit


@jit
def outer(p: Pair) -> float:
    return inner(p.first) - callee.GAIN * p.second


result = outer(Pair(3.0, 1.0))
"""


@pytest.mark.parametrize(
    ("old", "new", "result", "compiled"),
    [
        ("Return a multiple.", "Return the product\n\n    with the gain.", 4.0, False),
        ("    return x\n", "    return 2.0 * x\n", 4.0, False),  # is not called
        ("GAIN * x", "GAIN * x + 1.0", 5.0, True),
        ("GAIN = 2.0", "GAIN = 3.0", 6.0, True),
        ("first: float\n    second: float", "second: float\n    first: float", -4.0, True),
    ],
)
def test_a_function_is_compiled_again_when_what_it_depends_on_changes_and_only_then(
    monkeypatch, old, new, result, compiled
):
    """numba's own cache would keep the caller's old machine code, and compile again after each change of the file."""

    def run(callee: str) -> tuple[float, str]:
        for name, text in (("callee", callee), ("caller", CALLER)):
            module = ModuleType(f"ltv_mpc.{name}")
            monkeypatch.setitem(sys.modules, module.__name__, module)
            exec(compile(text, __file__, "exec"), vars(module))
        return module.result, kernel_hash(module.outer.py_func)

    before, after = run(CALLEE), run(CALLEE.replace(old, new))
    assert (before[0], after[0]) == (4.0, result)
    assert (before[1] != after[1]) == compiled


def test_the_cache_is_a_folder_of_the_compiler_that_children_inherit_or_a_temporary_one(tmp_path, monkeypatch):
    """A value of the user's for numba must not bring back stale code."""
    own = tmp_path / "ltv-mpc" / jit.fingerprint()
    for given in (tmp_path, own):
        monkeypatch.setenv("NUMBA_CACHE_DIR", str(given))
        assert jit.cache_folder() == (own, True)
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "nothing"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    folder, is_persistent = jit.cache_folder()
    assert folder.is_relative_to(tmp_path / "temporary")
    assert not is_persistent


@pytest.mark.parametrize("limit", [-1.0, 0.0, 0.5, 2.0, 3.0, 9.0, math.nan])
@pytest.mark.parametrize("values", [[], [0.0], [0.0, 2.0, 2.0, 3.0]])
def test_the_count_of_entries_up_to_a_limit_is_that_of_numpy(values, limit):
    ascending = np.array(values, dtype=np.float64)
    assert jit.count_up_to(ascending, limit) == np.searchsorted(ascending, limit, side="right")


def slow_to_compile(function: ast.FunctionDef) -> Iterator[str]:
    """Yield what takes numba seconds to compile, in every process that fills the cache."""
    for node in ast.walk(function):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            yield ast.unparse(node)
        if isinstance(node, ast.Attribute) and ast.unparse(node).startswith(("np.linalg.", "np.searchsorted")):
            yield ast.unparse(node)
        if isinstance(node, ast.Assign) and not all(isinstance(x, ast.Constant) for x in elements(node.value)):
            for target in node.targets:
                if any(isinstance(x, ast.Slice) for x in ast.walk(target)):  # the text of its error is compiled
                    yield ast.unparse(node)


def elements(value: ast.expr) -> list[ast.expr]:
    return value.elts if isinstance(value, ast.Tuple) else [value]


def test_no_compiled_function_contains_what_takes_seconds_to_compile():
    found = [
        f"{path.relative_to(ROOT)}: {text}"
        for path in (*(ROOT / "ltv_mpc").rglob("*.py"), *(ROOT / "sim").rglob("*.py"))
        if path.name != "shooting_fit.py"  # it is compiled for an identification only
        for function in ast.walk(ast.parse(path.read_text()))
        if isinstance(function, ast.FunctionDef) and any("jit" in ast.unparse(x) for x in function.decorator_list)
        for text in slow_to_compile(function)
    ]
    assert found == []


SECOND_PROCESS = """
import sys, warnings
from numba.core.errors import NumbaWarning
warnings.simplefilter("error", NumbaWarning)  # "Cannot cache compiled function ..."
from ltv_mpc import ControllerConfig, Vehicle, references
from services.processes.controller import warm_up

for solver in ("osqp", "riccati"):
    warm_up(Vehicle.load("paper"), references.Hold(depth_m=3.0), ControllerConfig(solver=solver))
print(sum(
    sum(value.stats.cache_misses.values())
    for name, module in list(sys.modules.items()) if name.startswith("ltv_mpc")
    for value in vars(module).values() if hasattr(value, "stats")
))
"""


def test_a_cache_has_no_other_attributes_than_numbas() -> None:
    cache = jit.copy_to._cache  # type: ignore[attr-defined]
    assert cache.cache_path
    assert not hasattr(cache, "made_up")


def test_every_kernel_can_be_cached_and_a_second_process_compiles_nothing():
    """The address of a C function as a constant could not be cached."""
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-P", "-c", SECOND_PROCESS], capture_output=True, text=True, check=False, timeout=600
        )
        assert done.returncode == 0, done.stderr[-2000:]
        compiled = done.stdout.split()[-1]
        if compiled == "0":  # another process has compiled it all
            break
    assert compiled == "0"


SHARING_PROCESS = """
from ltv_mpc import jit
from ltv_mpc.so3 import exp

jit.share_compilation()
print("ready", flush=True)
input()  # until the other process is ready, too
exp(1.0, 1.0, 1.0)
print(sum(exp.stats.cache_misses.values()))
"""


def test_of_two_processes_that_share_the_compilation_one_compiles_a_function(tmp_path):
    processes = [
        subprocess.Popen(
            [sys.executable, "-P", "-c", SHARING_PROCESS],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    for process in processes:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.flush()
    assert sorted(process.communicate()[0] for process in processes) == ["0\n", "1\n"]
