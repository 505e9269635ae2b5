"""`make mutants`: the sign of every term flipped, one at a time; at least one test must fail for each.

Nothing is mutated where people work: the tree is copied (what git tracks, and what is new), and the copy is changed.
The tests of a file are those of ``plan.toml``, in its order, to the first failure. What survives stands in
``survivors.toml`` with its reason, or the command fails; so it does when a listed survivor is killed or gone.
For some files only: ``make mutants FILES="ltv_mpc/vehicle/dynamics.py"``.
"""

from __future__ import annotations

import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from tests.mutation import trial
from tests.mutation.signs import mutants

HERE = Path(__file__).resolve().parent
BASELINE_LIMIT_S = 600.0
SLOWER = 10.0
"""A mutant whose tests take this many times as long as the original's has hung, and counts as killed."""


class Survivor(NamedTuple):
    """Sign flip that no test detected: its file and its changed line."""

    file: str
    line: str


class Group(NamedTuple):
    """Entry of ``plan.toml``: files and their tests."""

    files: list[str]
    tests: list[str]


def groups(chosen: list[str]) -> list[Group]:
    """Return the plan, or its part for the ``chosen`` files."""
    plan = [Group(x["files"], x["tests"]) for x in tomllib.loads((HERE / "plan.toml").read_text())["group"]]
    if unknown := set(chosen) - {file for group in plan for file in group.files}:
        sys.exit(f"not in {HERE / 'plan.toml'}: {', '.join(sorted(unknown))}")
    plan = [group._replace(files=[x for x in group.files if not chosen or x in chosen]) for group in plan]
    return [group for group in plan if group.files]


def survivors_of(file: str, folder: Path, tests: list[str], limit_s: float, console: Console) -> list[Survivor]:
    """Return the mutants of a file that pass all ``tests``; print them when they are found."""
    source = (folder / file).read_text()
    found = []
    for line, code in mutants(source):
        (folder / file).write_text(code)
        if trial.outcome(folder, tests, limit_s) == 0:
            found.append(Survivor(file, code.splitlines()[line - 1].strip()))
            console.print(f"survived  {file}:{line}  {found[-1].line}")
    (folder / file).write_text(source)
    return found


def main(chosen: list[str]) -> int:
    """Print the table of all files; return 1 if the survivors differ from the listed ones."""
    plan = groups(chosen)
    console = Console(width=120, soft_wrap=True, highlight=False, markup=False)
    table = Table("file", "mutants", "killed", "survived", "seconds")
    found: set[Survivor] = set()
    with tempfile.TemporaryDirectory(prefix="mutants-") as name:
        folder = Path(name).resolve()
        trial.copy_tree(folder)
        for group in plan:
            start = time.monotonic()
            if (code := trial.outcome(folder, group.tests, BASELINE_LIMIT_S)) != 0:
                console.print(f"these fail before anything is mutated (pytest: {code}): {' '.join(group.tests)}")
                return 1
            limit_s = SLOWER * (time.monotonic() - start)
            for file in group.files:
                start = time.monotonic()
                number = len(mutants((folder / file).read_text()))
                survivors = survivors_of(file, folder, group.tests, limit_s, console)
                figures = number, number - len(survivors), len(survivors), round(time.monotonic() - start)
                table.add_row(file, *map(str, figures))
                found.update(survivors)
    console.print(table)
    tried = {file for group in plan for file in group.files}
    entries = tomllib.loads((HERE / "survivors.toml").read_text())["survivor"]
    listed = {Survivor(x["file"], x["line"]): x["reason"] for x in entries if x["file"] in tried}
    for survivor in sorted(found | listed.keys()):
        verdict = (
            "NO TEST FAILS" if survivor not in listed else "LISTED, BUT KILLED" if survivor not in found else "listed"
        )
        console.print(f"{verdict}: {survivor.file}: {survivor.line}  # {listed.get(survivor, 'why?')}")
    return int(found != listed.keys())


if __name__ == "__main__":
    trial.prepare()
    sys.exit(main(sys.argv[1:]))
