"""The generated reference is complete, renders docstrings verbatim and loads nothing from the network."""

from __future__ import annotations

import builtins
import doctest
import enum
import importlib
import inspect
import pydoc
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Protocol

import msgspec
import pytest
from typer.core import TyperGroup
from typer.main import get_command

from ltv_mpc import references, settings_schema
from services.cli.app import app
from sim.scenario import Scenario
from tests.docs.pages import ROOT, blocks


def extension(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Import an extension of the site from docs/extensions, which is not a package."""
    monkeypatch.syspath_prepend(ROOT / "docs" / "extensions")
    for own in ("anchors", "commands", "docstrings", "drawings", "glossary", "offline", "settings"):
        monkeypatch.delitem(sys.modules, own, raising=False)
    return importlib.import_module(name)


def test_every_command_and_every_option_is_on_the_page_of_options_once(monkeypatch: pytest.MonkeyPatch) -> None:
    page = "\n".join(extension("commands", monkeypatch).page())
    sections = dict(re.findall(r"^### ltv-mpc ([\w -]+)\n(.*?)(?=^##|\Z)", page, re.MULTILINE | re.DOTALL))
    assert page.count("\n### ") == len(sections)
    panels = re.findall(r"^## (.+)$", page, re.MULTILINE)
    assert len(set(panels)) == len(panels)

    def all_of(group: TyperGroup, words: tuple[str, ...]) -> int:
        count = 0
        for name, command in group.commands.items():
            if isinstance(command, TyperGroup):
                count += all_of(command, (*words, name))
                continue
            text = sections[" ".join((*words, name))]
            for parameter in command.params:
                if parameter.param_type_name == "option":
                    assert all(option in text for option in (*parameter.opts, *parameter.secondary_opts)), name
            count += 1
        return count

    group = get_command(app)
    assert isinstance(group, TyperGroup)
    assert all_of(group, ()) == len(sections) >= 24


def test_the_page_of_commands_has_a_word_for_each() -> None:
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    for name in get_command(app).commands:  # type: ignore[attr-defined]
        assert re.search(rf"^\|[^|]*`{name}\b", page, re.MULTILINE), name


def test_every_key_of_a_scenario_is_on_the_page_of_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    page = "\n".join(extension("settings", monkeypatch).tables(Scenario, ()))
    shown, table = set(), ""
    for line in page.splitlines():
        if heading := re.match(r"## `\[(.+)\]`", line):
            table = f"{heading[1]}."
        elif row := re.match(r"\| `(\w+)` \|", line):
            shown.add(f"{table}{row[1]}")
    assert set(settings_schema.scalar_fields(Scenario)) - {"made_by"} <= shown
    assert "| `period_s` | a number >= 0.02 and \\<= 60 | `0.3` |" in page


@pytest.mark.parametrize("name", ["processes", "layers", "cycle", "estimator"])
def test_the_drawings_of_the_architecture_are_those_of_the_code(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = extension("drawings", monkeypatch).DRAWINGS[name]()
    assert (ROOT / "docs" / "figures" / f"{name}.svg").read_text(encoding="utf-8") == drawn, "run `make protocol`"


def test_the_glossary_is_short_and_each_page_that_it_names_has_the_term() -> None:
    page = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    entries = re.findall(r"^## (.+)\n\n.*\]\((\S+)\)$", page, re.MULTILINE)
    assert len(entries) == page.count("\n## ") <= 60
    assert [term.lower() for term, _ in entries] == sorted(term.lower() for term, _ in entries)
    for terms, target in entries:
        explained = (ROOT / "docs" / target).read_text(encoding="utf-8").lower()
        for term in terms.lower().split(", "):
            assert re.search(rf"\b{re.escape(term)}s?\b", explained), f"{target} does not have {term}"


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
    assert {f"ltv_mpc.references.{name}" for name in references.__all__} <= set(entries)
    examples = {name: re.findall(r"^ +(?:>>>|\.\.\.) (.*)", entry, re.MULTILINE) for name, entry in entries.items()}
    assert [name for name, lines in examples.items() if not lines] == []
    too_wide = [line for lines in examples.values() for line in lines if len(line) > 80]
    assert too_wide == [], "the site cuts these lines on a screen of 1280 pixels"


def test_every_type_in_a_signature_has_an_entry() -> None:
    entries = python_entries()
    listed = {name.rpartition(".")[2] for name in entries} | set(re.findall(r"py:type:: (\w+)", python_names()))
    listed |= {*dir(builtins), "Sequence", "SolverFactory", "csc_array"}  # a function that returns a Solver; SciPy's
    missing = set()
    for name in entries:
        thing = pydoc.locate(name)
        if callable(thing) and not has_table(thing):
            signature = inspect.signature(thing)
            types = [signature.return_annotation, *(one.annotation for one in signature.parameters.values())]
            words = re.findall(r"\w+", " ".join(one for one in types if isinstance(one, str)))
            missing |= {(name, word) for word in words if word not in listed}
    assert missing == set()


def has_table(thing: object) -> bool:
    """Return True for a type whose fields are in a table, not in a signature."""
    return isinstance(thing, type) and issubclass(thing, (msgspec.Struct, enum.Enum, Protocol))
