"""Readability of the code: docstrings are statements in plain modern English, functions and classes are short.

Ruff checks the number of parameters and that every public name of ltv_mpc has a docstring.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, TypeAlias

import pytest

ROOT = Path(__file__).resolve().parents[2]
MAX_FUNCTION_LINES, MAX_ATTRIBUTES = 60, 12
MAX_WITHOUT_PARAMETERS = 20  # overrides, which say nothing again; the limit is never raised

Function: TypeAlias = ast.FunctionDef | ast.AsyncFunctionDef
Documented: TypeAlias = ast.Module | ast.ClassDef | Function

# A docstring that opens with one of these continues the name above it instead of making a statement of its own.
FRAGMENT = re.compile(
    r"(?:Of|What|Whether|Than|So|Those|Which|Who|Whom|Whose|Where|Its|By|Into|Onto|From|As|Unlike|Besides|Without|With"
    r"|In|On|At|To|For|Before|After|Until|Since|While|Once|Not|Nothing|How|And|Or|But|Here|There|Other|None|Towards"
    r"|Over|Under)\b"
)
# The summary of a function is a command; one that opens with an article or a quantity lacks the verb.
WITHOUT_VERB = re.compile(r"(?:The|An?|One|All|Each|Every|Another)\b")
UNIDIOMATIC = re.compile(
    r"\b(?:said|told|tells|heard|hears|anew|whoever|shall|foretold|unheard|unsaid|doubted|thereby|thereof|wherein|lest"
    r"|begun|of themselves|goes on|go on from|let in|turned back|made up(?! of)|is worth|lets? (?:the thrusters )?go"
    r"|by turns|the other way round|comes? to nothing|in the midst|none of its)\b"
)
PARAMETERS = re.compile(r"^\s*Parameters\n\s*-{3,}", re.MULTILINE)


class Named(NamedTuple):
    """Definition in a file, with its docstring."""

    path: str
    node: Documented
    docstring: str

    def __str__(self) -> str:
        return f"{self.path} {getattr(self.node, 'name', 'module')}"


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and all statements in it, without their expressions, which are most of a tree."""
    yield node
    for name in ("body", "orelse", "handlers", "finalbody", "cases"):
        for child in getattr(node, name, ()):
            yield from statements(child)


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    """Return the text of each file of the three packages."""
    paths = (path for package in ("ltv_mpc", "sim", "services") for path in sorted((ROOT / package).rglob("*.py")))
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in paths}


@pytest.fixture(scope="module")
def names(texts: dict[str, str]) -> list[Named]:
    return [
        Named(path, node, ast.get_docstring(node) or "")
        for path, text in texts.items()
        for node in statements(ast.parse(text))
        if isinstance(node, Documented)
    ]


def is_fragment(node: Documented, summary: str) -> bool:
    is_property = any("property" in ast.unparse(each) for each in getattr(node, "decorator_list", ()))
    verb_missing = isinstance(node, Function) and not is_property and WITHOUT_VERB.match(summary)
    lower_case = summary[:1].islower() and "=" not in summary  # a summary may be an equation
    return bool(FRAGMENT.match(summary) or verb_missing or lower_case)


def test_the_first_line_of_a_docstring_is_a_whole_statement(names: list[Named]) -> None:
    assert [str(of) for of in names if of.docstring and is_fragment(of.node, of.docstring.splitlines()[0])] == []


def test_docstrings_and_comments_have_no_unidiomatic_word(names: list[Named], texts: dict[str, str]) -> None:
    assert [f"{of}: {word}" for of in names for word in UNIDIOMATIC.findall(of.docstring)] == []
    comments = [(path, line.partition("# ")[2]) for path, text in texts.items() for line in text.splitlines()]
    assert [(path, comment) for path, comment in comments if UNIDIOMATIC.search(comment)] == []


def test_public_functions_of_the_library_describe_their_parameters(names: list[Named]) -> None:
    found = [
        str(of)
        for of in names
        if isinstance(of.node, Function) and of.path.startswith("ltv_mpc/") and not of.node.name.startswith("_")
        if sum(map(len, (of.node.args.posonlyargs, of.node.args.args, of.node.args.kwonlyargs))) > 1
        if of.docstring and not PARAMETERS.search(of.docstring)
    ]
    assert len(found) <= MAX_WITHOUT_PARAMETERS, found


def lines(node: ast.stmt) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def test_functions_are_short_and_classes_have_few_attributes(names: list[Named]) -> None:
    long = [
        str(of)
        for of in names
        if isinstance(of.node, Function)
        and lines(of.node) - bool(of.docstring) * lines(of.node.body[0]) > MAX_FUNCTION_LINES
    ]
    assert long == []
    for of in (of for of in names if isinstance(of.node, ast.ClassDef)):
        assigned = (node for node in ast.walk(of.node) if isinstance(node, ast.Assign | ast.AnnAssign))
        targets = (
            ast.unparse(each)
            for node in assigned
            for each in (node.targets if isinstance(node, ast.Assign) else [node.target])
        )
        own = {target for target in targets if target.startswith("self.") and target[5:].isidentifier()}
        assert len(own) <= MAX_ATTRIBUTES, str(of)
