"""`make mutants`: the sign of every term flipped, one at a time; at least one test must fail for each.

Nothing is mutated where people work: the tree is copied (what git tracks, and what is new), and the copy is changed.
Nothing compiled can be stale: tests run without numba's compiler and without byte code. Each run is a fork of a process
that has loaded the libraries and nothing of this project. The tests of a file are those of ``plan.toml``, in its order,
to the first failure. What survives stands in ``survivors.toml`` with its reason, or the command fails; so it does when
a listed survivor is killed or gone. For some files only: ``make mutants FILES="ltv_mpc/vehicle/dynamics.py"``.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import Phase, settings
from rich.console import Console
from rich.table import Table

from tests.mutation.signs import mutants

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
LIBRARIES = (
    "numpy",
    "scipy.sparse",
    "scipy.integrate",
    "scipy.linalg",
    "numba",
    "msgspec",
    "osqp",
    "daqp",
    "qpsolvers",
)
OURS = ("ltv_mpc", "sim", "services")
SLOWER = 10.0
"""A mutant whose tests take this many times as long as the original's has hung, and counts as killed."""


class Mutant(NamedTuple):
    """A flip that no test noticed: its file, and its line as it then read."""

    file: str
    line: str


class FirstExample:
    """A pytest plugin: hypothesis need not look for the simplest example that fails, and fewer of them will do."""

    def pytest_sessionstart(self) -> None:
        """After the conftest that sets this project's profile, before tests are collected."""
        settings.register_profile("mutants", settings.default, phases=[Phase.explicit, Phase.generate], max_examples=25)
        settings.load_profile("mutants")


def copied(folder: Path) -> None:
    """The tree as it is now, what git ignores left out."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


def run_tests(folder: Path, tests: list[str]) -> None:
    """In a fork: to the first failure, silently; the exit code says what came of it."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    os.chdir(folder)
    sys.path.insert(0, str(folder))
    code = pytest.main(
        ["-x", "-q", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning", *tests]
    )
    package = import_module(OURS[0])
    inside = package.__file__ is not None and Path(package.__file__).is_relative_to(folder)
    os._exit(int(code) if inside else 99)


def outcome(folder: Path, tests: list[str], limit_s: float) -> int | None:
    """pytest's exit code; None if it did not end in time."""
    child = multiprocessing.get_context("fork").Process(target=run_tests, args=(folder, tests))
    child.start()
    child.join(limit_s)
    if child.is_alive():
        child.kill()
        child.join()
        return None
    return child.exitcode


def survivors_of(
    folder: Path, file: str, tests: list[str], limit_s: float, console: Console
) -> tuple[int, list[Mutant]]:
    """How many mutants ``file`` has, and those that passed all ``tests``."""
    source = (folder / file).read_text()
    flips = mutants(source)
    survivors = []
    for line, code in flips:
        (folder / file).write_text(code)
        if outcome(folder, tests, limit_s) == 0:
            survivors.append(Mutant(file, code.splitlines()[line - 1].strip()))
            console.print(f"survived  {file}:{line}  {survivors[-1].line}", highlight=False, markup=False)
    (folder / file).write_text(source)
    return len(flips), survivors


def main(chosen: list[str]) -> int:
    """The table of all files; 1 if the survivors are not those that are listed."""
    console = Console(width=120, soft_wrap=True)
    plan = tomllib.loads((HERE / "plan.toml").read_text())["group"]
    reasons = tomllib.loads((HERE / "survivors.toml").read_text())["survivor"]
    table = Table("file", "mutants", "killed", "survived", "seconds")
    found: set[Mutant] = set()
    tried: set[str] = set()
    with tempfile.TemporaryDirectory(prefix="mutants-") as name:
        folder = Path(name).resolve()
        copied(folder)
        for group in plan:
            files = [x for x in group["files"] if not chosen or x in chosen]
            if not files:
                continue
            start = time.monotonic()
            if (code := outcome(folder, group["tests"], 600.0)) != 0:
                console.print(f"the tests fail before anything is mutated (pytest: {code}): {group['tests']}")
                return 1
            limit_s = SLOWER * (time.monotonic() - start)
            for file in files:
                start = time.monotonic()
                number, survivors = survivors_of(folder, file, group["tests"], limit_s, console)
                table.add_row(
                    file,
                    *(str(x) for x in (number, number - len(survivors), len(survivors))),
                    f"{time.monotonic() - start:.0f}",
                )
                found.update(survivors)
                tried.add(file)
    listed = {Mutant(x["file"], x["line"]) for x in reasons if x["file"] in tried}
    console.print(table)
    for mutant in sorted(found - listed):
        console.print(f"NO TEST FAILS     {mutant.file}: {mutant.line}", highlight=False, markup=False)
    for mutant in sorted(listed - found):
        console.print(f"LISTED BUT KILLED {mutant.file}: {mutant.line}", highlight=False, markup=False)
    return 0 if found == listed else 1


if __name__ == "__main__":
    os.environ |= {"NUMBA_DISABLE_JIT": "1", "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
    sys.dont_write_bytecode = True
    for library in LIBRARIES:
        import_module(library)
    assert not {x.split(".")[0] for x in sys.modules} & set(OURS)
    sys.exit(main(sys.argv[1:]))
