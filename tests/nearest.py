"""Run the tests nearest to what git says has changed: ``python -P -m tests.nearest [OPTION of pytest ...]``

Nearest to a module are the tests in the file of its name, and those that import it; if there are none, those that
import a module that imports it, and so on: at most ``MOST`` files, those of its own folder first. Tests that start
processes or take long for other reasons are left to ``make test``. A map of which lines a test runs, as of
pytest-testmon, does not know compiled functions.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable
from itertools import takewhile
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("ltv_mpc", "sim", "services", "benchmarks", "tests")
LONG = (
    *(f"tests.{name}" for name in ("benchmarks", "browser", "docs", "examples", "foreign_plant", "fuzz", "strangers")),
    *("tests.package", "tests.system", "tests.services.dashboard", "tests.services.supervisor.test_processes"),
    *("tests.services.tools.campaign", "tests.services.tools.profile", "tests.services.replay"),
)
"""Tests that a change of a module does not run, unless one of them has the module's name."""
MOST = 12
OF_PAGES = ("tests/docs/test_links.py", "tests/docs/test_pages.py")


def changed() -> list[str]:
    """Return the files that differ from the last commit and are still there, new ones included."""
    commands = (("diff", "--name-only", "HEAD"), ("ls-files", "--others", "--exclude-standard"))
    names = (subprocess.run(["git", *each], cwd=ROOT, capture_output=True, text=True, check=True) for each in commands)
    return sorted({name for each in names for name in each.stdout.split("\n") if name and (ROOT / name).exists()})


def is_test(module: str) -> bool:
    return module.startswith("tests.") and module.rpartition(".")[2].startswith("test_")


def path_of(module: str) -> str:
    return f"{module.replace('.', '/')}.py"


def nearest(module: str, graph: grimp.ImportGraph) -> set[str]:
    """Return the files of the tests nearest to a module."""
    package, _, name = module.rpartition(".")
    namesake = f"tests.{package}.test_{name}"
    found = {namesake} & graph.modules
    level, seen = {module} & graph.modules, set[str]()
    while level and not found - {namesake}:
        seen |= level
        level = {each for one in level for each in graph.find_modules_that_directly_import(one)} - seen
        found |= {each for each in level if is_test(each) and not each.startswith(LONG)}
    own = module.split(".")
    by_folder = sorted(found, key=lambda test: (-common(own, test.split(".")[1:]), test != namesake, test))
    return {path_of(each) for each in by_folder[:MOST]}


def common(a: list[str], b: list[str]) -> int:
    """Return the number of first parts that two names have in common."""
    return len(list(takewhile(lambda pair: pair[0] == pair[1], zip(a, b, strict=False))))


def tests_of(files: Iterable[str]) -> set[str]:
    """Return the test files to run after a change of these files."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    found: set[str] = set()
    for file in files:
        path = Path(file)
        if path.name == "conftest.py":
            found.add(str(path.parent))
        elif path.name.startswith("test_"):
            found.add(file)
        elif path.suffix == ".py" and path.parts[0] in PACKAGES:
            found |= nearest(".".join(path.with_suffix("").parts).removesuffix(".__init__"), graph)
        elif path.suffix == ".md":
            found.update(OF_PAGES)
    return found


def main(options: list[str]) -> int:
    """Run the tests; return pytest's exit code."""
    files = changed()
    if not (tests := sorted(tests_of(files))):
        sys.stdout.write(f"no test is near to the {len(files)} changed files: make test runs all\n")
        return 0
    sys.stdout.write(f"{len(tests)} test files near to {', '.join(files)}\n")
    return int(pytest.main(["-q", "-n", "2", "--dist", "loadfile", *options, *tests]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
