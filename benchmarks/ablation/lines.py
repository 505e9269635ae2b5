"""Count lines of code: without blank lines, comments and docstrings."""

from __future__ import annotations

import ast
import io
import tokenize
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

_NO_CODE = frozenset({
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER,
})  # fmt: skip


def count(places: Iterable[str]) -> int:
    """Count the lines of code of these places, "path.py" or "path.py:Class.function". Raises KeyError."""
    return sum(len(_lines(place)) for place in places)


def _lines(place: str) -> set[int]:
    path, _, name = place.partition(":")
    source = (ROOT / path).read_text()
    tree = ast.parse(source)
    lines = _code(source) - _docstrings(tree)
    if not name:
        return lines
    node: ast.AST = tree
    for part in name.split("."):
        node = _child(node, part)
    return lines & _span(node)


def _child(node: ast.AST, name: str) -> ast.AST:
    for child in ast.walk(node):
        if isinstance(child, ast.FunctionDef | ast.ClassDef) and child.name == name:
            return child
    raise KeyError(name)


def _span(node: ast.AST) -> set[int]:
    assert isinstance(node, ast.FunctionDef | ast.ClassDef)
    first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
    return set(range(first, (node.end_lineno or node.lineno) + 1))


def _code(source: str) -> set[int]:
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    return lines


def _docstrings(tree: ast.AST) -> set[int]:
    """Return the lines of all statements that are only a string."""
    return {
        line
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
