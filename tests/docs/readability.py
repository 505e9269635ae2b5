"""Readability figures of the code: ``python -m tests.docs.readability`` prints each figure and its places.

A figure shows where to look. It is no proof that a text is clear. ``test_readability.py`` holds the limits.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("ltv_mpc", "sim", "services")
LIBRARY = "ltv_mpc"

MAX_FUNCTION_LINES = 60
MAX_PARAMETERS = 8
MAX_ATTRIBUTES = 12
MAX_TEST_NAME = 80

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
# The underscored methods of named tuples and os._exit are public and documented.
PRIVATE = re.compile(r"(?<!self)(?<!cls)(?<!os)\._(?!(?:replace|asdict|fields|make)\b)[a-z]\w*")
PATCHED = re.compile(r"monkeypatch\.(?:setattr|delattr)")


@dataclass(frozen=True)
class Place:
    """Position in the code, with the text that was found there."""

    path: str
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line} {self.text}"


@dataclass(frozen=True)
class Source:
    """Parsed Python file."""

    path: str
    text: str
    tree: ast.Module

    @property
    def package(self) -> str:
        """Top-level folder."""
        return self.path.partition("/")[0]

    def place(self, node: ast.AST, text: str) -> Place:
        """Return the position of ``node``."""
        return Place(self.path, getattr(node, "lineno", 1), text)

    @cached_property
    def _nodes(self) -> list[ast.AST]:
        kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef, ast.ImportFrom)
        return [node for node in statements(self.tree) if isinstance(node, kinds)]

    def nodes(self, *kinds: type[ast.AST]) -> Iterator[ast.AST]:
        """Yield every definition or import of these kinds."""
        return (node for node in self._nodes if isinstance(node, kinds))


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and all statements in it, without their expressions, which are most of a tree."""
    yield node
    for name in ("body", "orelse", "handlers", "finalbody", "cases"):
        for child in getattr(node, name, ()):
            yield from statements(child)


def sources(*folders: str) -> list[Source]:
    """Parse every Python file below these folders of the project."""
    paths = (path for folder in folders for path in sorted((ROOT / folder).rglob("*.py")))
    texts = ((path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")) for path in paths)
    return [Source(path, text, ast.parse(text)) for path, text in texts]


# --- docstrings and comments -----------------------------------------------------------------------------------------


def docstrings(code: list[Source]) -> Iterator[tuple[Source, Documented, str]]:
    """Yield every docstring with the definition that it belongs to."""
    for source in code:
        for node in source.nodes(ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef):
            assert isinstance(node, Documented)
            if text := ast.get_docstring(node):
                yield source, node, text


def fragments(code: list[Source]) -> list[Place]:
    """List the docstrings whose first line is no statement."""
    return [
        source.place(node, f"{_name(node)}: {text.splitlines()[0]}")
        for source, node, text in docstrings(code)
        if _is_fragment(node, text.splitlines()[0])
    ]


def _is_fragment(node: Documented, summary: str) -> bool:
    verb_missing = isinstance(node, Function) and not _is_property(node) and WITHOUT_VERB.match(summary)
    lower_case = summary[:1].islower() and "=" not in summary  # a summary may be an equation
    return bool(FRAGMENT.match(summary) or verb_missing or lower_case)


def _is_property(function: Function) -> bool:
    return any("property" in ast.unparse(decorator) for decorator in function.decorator_list)


def unidiomatic_words(code: list[Source]) -> list[Place]:
    """List the old-fashioned and figurative words in docstrings and comments."""
    in_docstrings = [
        source.place(node, f"{_name(node)}: {word}")
        for source, node, text in docstrings(code)
        for word in UNIDIOMATIC.findall(text)
    ]
    in_comments = [
        Place(source.path, number, word)
        for source in code
        for number, line in enumerate(source.text.splitlines(), 1)
        for word in UNIDIOMATIC.findall(line.partition("# ")[2])
    ]
    return in_docstrings + in_comments


def missing_docstrings(code: list[Source]) -> list[Place]:
    """List the public classes, functions and methods of the library without a docstring."""
    return [
        source.place(node, node.name)
        for source in code
        if source.package == LIBRARY
        for node in source.nodes(ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
        if isinstance(node, ast.ClassDef | Function)
        and not node.name.startswith("_")
        and node.col_offset <= 4  # deeper ones are local to a function
        and ast.get_docstring(node) is None
    ]


def undescribed_parameters(code: list[Source]) -> list[Place]:
    """List the public functions of the library that have several parameters and no Parameters section."""
    return [
        source.place(node, node.name)
        for source, node, text in docstrings(code)
        if source.package == LIBRARY
        and isinstance(node, Function)
        and not node.name.startswith("_")
        and len(_parameters(node)) > 1
        and not PARAMETERS.search(text)
    ]


# --- size ------------------------------------------------------------------------------------------------------------


def long_functions(code: list[Source]) -> list[Place]:
    """List the functions of more than ``MAX_FUNCTION_LINES`` lines, docstring not counted."""
    return [
        source.place(node, f"{node.name}: {lines} lines")
        for source, node in _functions(code)
        if (lines := _lines(node) - _docstring_lines(node)) > MAX_FUNCTION_LINES
    ]


def many_parameters(code: list[Source]) -> list[Place]:
    """List the functions of more than ``MAX_PARAMETERS`` parameters."""
    return [
        source.place(node, f"{node.name}: {len(_parameters(node))} parameters")
        for source, node in _functions(code)
        if len(_parameters(node)) > MAX_PARAMETERS
    ]


def many_attributes(code: list[Source]) -> list[Place]:
    """List the classes of more than ``MAX_ATTRIBUTES`` attributes of ``self``."""
    return [
        source.place(node, f"{node.name}: {len(attributes)} attributes")
        for source in code
        for node in source.nodes(ast.ClassDef)
        if isinstance(node, ast.ClassDef) and len(attributes := _attributes(node)) > MAX_ATTRIBUTES
    ]


def _functions(code: list[Source]) -> Iterator[tuple[Source, Function]]:
    for source in code:
        for node in source.nodes(ast.FunctionDef, ast.AsyncFunctionDef):
            assert isinstance(node, Function)
            yield source, node


def _parameters(function: Function) -> list[ast.arg]:
    arguments = function.args
    return [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]


def _attributes(of: ast.ClassDef) -> set[str]:
    """Return the names assigned to ``self`` in a class."""
    assigned = (
        target
        for node in ast.walk(of)
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
    )
    return {
        target.attr
        for target in assigned
        if isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name) and target.value.id == "self"
    }


def _lines(node: ast.stmt) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def _docstring_lines(function: Function) -> int:
    return 0 if ast.get_docstring(function) is None else _lines(function.body[0])


def _name(node: Documented) -> str:
    return "module" if isinstance(node, ast.Module) else node.name


# --- folders and tests -----------------------------------------------------------------------------------------------


def mutual_imports(code: list[Source]) -> list[Place]:
    """List the folders of ``services`` that import each other."""
    imports: dict[tuple[str, str], Place] = {}
    for source in code:
        parts = source.path.split("/")
        if parts[0] != "services" or len(parts) < 3:
            continue
        for node in source.nodes(ast.ImportFrom):
            assert isinstance(node, ast.ImportFrom)
            if node.module and node.module.startswith("services.") and node.module.split(".")[1] != parts[1]:
                there = node.module.split(".")[1]
                imports.setdefault((parts[1], there), source.place(node, f"{parts[1]} imports {there}"))
    return [place for (here, there), place in imports.items() if (there, here) in imports]


def private_attributes(tests: list[Source]) -> list[Place]:
    """List the uses of private attributes of other objects in the tests."""
    return _matches(tests, PRIVATE)


def patched_names(tests: list[Source]) -> list[Place]:
    """List the names that tests replace by monkeypatching."""
    return _matches(tests, PATCHED)


def long_test_names(tests: list[Source]) -> list[Place]:
    """List the tests whose name has more than ``MAX_TEST_NAME`` characters."""
    return [
        source.place(node, node.name)
        for source, node in _functions(tests)
        if node.name.startswith("test_") and len(node.name) > MAX_TEST_NAME
    ]


def _matches(code: list[Source], pattern: re.Pattern[str]) -> list[Place]:
    return [
        Place(source.path, number, word)
        for source in code
        for number, line in enumerate(source.text.splitlines(), 1)
        for word in pattern.findall(line)
    ]


OF_CODE: dict[str, Callable[[list[Source]], list[Place]]] = {
    "docstrings that open with a fragment": fragments,
    "unidiomatic words": unidiomatic_words,
    "public names of ltv_mpc without a docstring": missing_docstrings,
    "public functions of ltv_mpc without a Parameters section": undescribed_parameters,
    "functions above 60 lines": long_functions,
    "functions with more than 8 parameters": many_parameters,
    "classes with more than 12 attributes": many_attributes,
    "folders of services that import each other": mutual_imports,
}
OF_TESTS: dict[str, Callable[[list[Source]], list[Place]]] = {
    "private attributes in tests": private_attributes,
    "patched names in tests": patched_names,
    "names of tests above 80 characters": long_test_names,
}


def figures() -> dict[str, list[Place]]:
    """Return the places behind every figure, by the figure's name."""
    code, tests = sources(*PACKAGES), sources("tests")
    return {name: count(code) for name, count in OF_CODE.items()} | {name: of(tests) for name, of in OF_TESTS.items()}


def main() -> None:
    """Print the figures, then the places."""
    found = figures()
    sys.stdout.writelines(f"{len(places):5} {name}\n" for name, places in found.items())
    for name, places in found.items():
        sys.stdout.write(f"\n# {name}\n")
        sys.stdout.writelines(f"{place}\n" for place in places)


if __name__ == "__main__":
    main()
