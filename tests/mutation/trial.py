"""A copy of the tree, and the tests run in it by a process that knows nothing of this project yet.

Each run is a fork of a process that has loaded the libraries, which saves a second each time. Nothing compiled can be
stale: numba's compiler is off, and no byte code is written.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import Phase, settings

ROOT = Path(__file__).resolve().parents[2]
LIBRARIES = (
    "scipy.sparse",
    "scipy.integrate",
    "numba",
    "msgspec",
    "osqp",
    "daqp",
    "qpsolvers",
    "hypothesis.extra.numpy",
)
OPTIONS = ("-x", "-q", "--tb=no", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning")
NOT_THE_COPY = 99


class FirstExample:
    """Pytest plugin: hypothesis does not simplify failing examples and tries fewer of them."""

    def pytest_sessionstart(self) -> None:
        """Change the hypothesis profile after the conftest has set it, before tests are collected."""
        settings.register_profile("mutants", settings(phases=[Phase.explicit, Phase.generate], max_examples=25))
        settings.load_profile("mutants")


def prepare() -> None:
    """Prepare this process; call it once, before anything of this project is imported."""
    os.environ |= {"NUMBA_DISABLE_JIT": "1", "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
    sys.dont_write_bytecode = True
    for library in LIBRARIES:
        import_module(library)


def copy_tree(folder: Path) -> None:
    """Copy the tree without the files that git ignores."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    )
    for name in listed.stdout.decode().split("\0"):
        if name and (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


def outcome(folder: Path, tests: list[str], limit_s: float) -> int | None:
    """Return pytest's exit code for ``tests`` in ``folder``, to the first failure; None after the time limit."""
    child = multiprocessing.get_context("fork").Process(target=_run_tests, args=(folder, tests))
    child.start()
    child.join(limit_s)
    if child.is_alive():
        child.kill()
        child.join()
        return None
    return child.exitcode


def _run_tests(folder: Path, tests: list[str]) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    os.chdir(folder)
    sys.path.insert(0, str(folder))
    code = pytest.main([*OPTIONS, *tests], plugins=[FirstExample()])
    loaded = sys.modules.get("ltv_mpc")
    if loaded is not None and not str(loaded.__file__).startswith(str(folder)):
        code = NOT_THE_COPY
    os._exit(code)
