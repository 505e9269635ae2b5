"""The reference is that of the code: commands, drawings, and the examples of the Python names."""

from __future__ import annotations

import doctest
import importlib
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from typer.main import get_command

import ltv_mpc
from ltv_mpc import references
from services.cli.app import app
from tests.docs.pages import ROOT, blocks


def extension(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Import an extension of the site from docs/extensions, which is not a package."""
    monkeypatch.syspath_prepend(ROOT / "docs" / "extensions")
    for own in ("anchors", "commands", "docstrings", "drawings", "glossary", "offline", "protocol_page", "settings"):
        monkeypatch.delitem(sys.modules, own, raising=False)
    return importlib.import_module(name)


def test_the_page_of_commands_has_a_word_for_each() -> None:
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    for name in get_command(app).commands:  # type: ignore[attr-defined]
        assert re.search(rf"^\|[^|]*`{name}\b", page, re.MULTILINE), name


@pytest.mark.parametrize("name", ["processes", "layers", "cycle", "estimator"])
def test_the_drawings_of_the_architecture_are_those_of_the_code(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = extension("drawings", monkeypatch).DRAWINGS[name]()
    assert (ROOT / "docs" / "figures" / f"{name}.svg").read_text(encoding="utf-8") == drawn, "run `make protocol`"


def python_names() -> str:
    (block,) = (block for block in blocks("docs/python.md") if block.language == "{eval-rst}")
    return block.text


def test_the_examples_of_the_python_names_give_what_they_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    page = doctest.DocTestParser().get_doctest(python_names(), {}, "docs/python.md", None, 0)
    lines: list[str] = []
    result = doctest.DocTestRunner(verbose=False).run(page, out=lines.append)
    assert result.failed == 0, "".join(lines)
    assert result.attempted >= 60


def python_entries() -> dict[str, str]:
    """Return the entries of the page of Python names by their dotted names; an entry has those of its methods."""
    found: dict[str, str] = {}
    for entry in re.split(r"^(?=\.\. auto)", python_names(), flags=re.MULTILINE)[1:]:
        names = re.findall(r"^ *\.\. auto(?!module)\w+:: (\S+)$", entry, re.MULTILINE)
        parts = re.split(r"^(?=   \.\. auto)", entry, flags=re.MULTILINE)[1:]
        for i, name in enumerate(names):
            path = ".".join((names[0], name)[: i + 1])
            found[path if path.startswith("ltv_mpc.") else f"ltv_mpc.{path}"] = parts[i - 1] if i else entry
    return found


def test_every_python_name_has_an_example() -> None:
    entries = python_entries()
    public = {*ltv_mpc.__all__, *(f"references.{name}" for name in references.__all__)}
    assert {f"ltv_mpc.{name}" for name in public - {"__version__", "references"}} <= set(entries)
    examples = {name: re.findall(r"^ +(?:>>>|\.\.\.) (.*)", entry, re.MULTILINE) for name, entry in entries.items()}
    assert [name for name, lines in examples.items() if not lines] == []
    too_wide = [line for lines in examples.values() for line in lines if len(line) > 80]
    assert too_wide == [], "the site cuts these lines on a screen of 1280 pixels"
