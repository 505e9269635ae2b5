"""Changed tree: the files that a page "How to add ..." changes or adds, and programs that run with them.

The changed files are in a folder of their own, in front of the packages, so that compiled code stays valid.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.docs.pages import ROOT, blocks

IMPORT_CHANGED = """
import importlib.util, sys
from pathlib import Path

class Changed:
    '''Finder of the modules that the page has changed or added.'''
    @staticmethod
    def find_spec(name, path=None, target=None):
        part = name.replace(".", "/")
        for file, is_package in ((f"{part}/__init__.py", True), (f"{part}.py", False)):
            if Path(file).is_file():
                where = [str(Path(part).resolve()), f"{sys.argv[1]}/{part}"] if is_package else None
                file = Path(file).resolve()
                return importlib.util.spec_from_file_location(name, file, submodule_search_locations=where)
        return None

sys.meta_path.insert(0, Changed)
"""


def build(page: str, folder: Path) -> None:
    """Apply every block of a page in ``folder``."""
    for block in blocks(page):
        if block.language == "diff":
            _apply(block.text, folder)


def run(program: str, folder: Path) -> str:
    """Run a program with the changed files of ``folder`` and return its output."""
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_CHANGED + program, str(ROOT)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def _apply(text: str, folder: Path) -> None:
    """Apply one block: insert the new lines at their context and remove the old ones, or create the file."""
    head, *lines = text.splitlines()
    name = head.removeprefix("# ")
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    context = [line[1:] for line in lines if not line.startswith("+")]
    new = [line[1:] for line in lines if not line.startswith("-")]
    if not context:
        assert not (ROOT / name).exists(), f"{name}: the page does not say where its lines belong"
        path.write_text("\n".join(new) + "\n", encoding="utf-8")
        return
    old = (path if path.exists() else ROOT / name).read_text(encoding="utf-8")
    place = "\n".join(context) + "\n"
    assert old.count(place) == 1, f"{name}: {old.count(place)} places are\n{place}"
    path.write_text(old.replace(place, "\n".join(new) + "\n"), encoding="utf-8")
