"""Compiled code is never stale, and works where nothing can be written."""

from __future__ import annotations

import ast
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ltv_mpc import jit

ROOT = Path(__file__).resolve().parents[2]


CALLEE = '''
import numpy as np
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
from ltv_mpc.vehicle import callee
from ltv_mpc.vehicle.callee import Pair, inner
from ltv_mpc.jit import jit

@jit
def outer(p: Pair) -> float:
    return inner(p.first) - callee.GAIN * p.second

result = outer(Pair(3.0, 1.0)), len(outer.stats.cache_misses)
"""


def outcome(tree: Path, cache: Path) -> str:
    """Return the result of ``CALLER`` in a copy of the sources, and how many functions it had to compile."""
    code = "from ltv_mpc.vehicle import caller; print(*caller.result)"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": str(tree)}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=tree, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


CHANGES = (
    ("GAIN * x", "GAIN * x + 1.0", "5.0 1"),
    ("GAIN = 2.0", "GAIN = 3.0", "6.0 1"),
    ("first: float\n    second: float", "second: float\n    first: float", "-4.0 1"),
    ("    return x\n", "    return 2.0 * x\n", "4.0 0"),  # is not called
)
"""Old and new text of the callee, which has another docstring, the result, and the number of compiled functions."""


def test_a_function_is_compiled_again_when_what_it_depends_on_changes_and_only_then(tmp_path):
    """numba's own cache would keep the caller's old machine code, and compile again after each change of the file."""
    for name in ("one", "other"):  # two checkouts share what is the same
        tree = tmp_path / name
        shutil.copytree(ROOT / "ltv_mpc", tree / "ltv_mpc", ignore=shutil.ignore_patterns("__pycache__"))
        (tree / "ltv_mpc" / "vehicle" / "callee.py").write_text(CALLEE)
        (tree / "ltv_mpc" / "vehicle" / "caller.py").write_text(CALLER)
        assert outcome(tree, tmp_path / "cache") == ("4.0 1" if name == "one" else "4.0 0")
    callee = tree / "ltv_mpc" / "vehicle" / "callee.py"
    for old, new, expected in CHANGES:
        callee.write_text(
            CALLEE.replace("Return a multiple.", "Return the product\n\n    with the gain.").replace(old, new)
        )
        assert outcome(tree, tmp_path / "cache") == expected, new


def test_without_a_home_that_can_be_written_it_compiles_into_a_temporary_folder(tmp_path):
    (tmp_path / "file").touch()
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    environment |= {"HOME": str(tmp_path / "file" / "nothing"), "TMPDIR": str(tmp_path)}
    code = (
        "import numpy as np\n"
        "from ltv_mpc import jit\n"
        "from ltv_mpc.vehicle.thruster import thrust\n"
        "assert not jit.CACHE_IS_PERSISTENT\n"
        "print(jit.CACHE, thrust(2.0, 0.0, 1025.0, 0.25))"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(tmp_path))


def test_a_given_cache_folder_gets_a_subfolder_per_compiler_and_children_inherit_it(tmp_path):
    """A value of the user's for numba must not bring back stale code."""
    code = "from ltv_mpc import jit; print(jit.CACHE)"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-P", "-c", code]
    first = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip()
    assert first == str(tmp_path / "ltv-mpc" / jit.fingerprint())
    environment["NUMBA_CACHE_DIR"] = first
    assert subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.strip() == first


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
