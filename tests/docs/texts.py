"""List of every text that a user can meet: ``python -m tests.docs.texts [KIND ...]`` prints it, grouped by file.

    help    each command, argument and option, from the command line itself
    error   the text of an exception
    plot    titles, axis labels, legends and notes of plots and figures
    text    every other sentence in the code: status, verdict, event and log lines, reasons in messages
    page    texts of the live page and the report (HTML, JavaScript)

Everything but help is read from the source. ``{...}`` stands for a value. Docstrings are not listed.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import typer

from services.cli.app import app
from tests.docs.readability import PACKAGES, ROOT, Source, sources

PLOT_FOLDERS = ("services/reporting/plots/", "services/reporting/figures/")
PLOT_KEYWORDS = ("title", "label", "note", "empty", "xlabel", "ylabel")
PAGES = ("services/dashboard/static", "services/reporting/static")
SENTENCE = re.compile(r"[A-Za-z]{2,}[,;:.)]? +\(?[a-z{`]")
"""Two words one after the other: names, formats and patterns are no sentences."""
# Strings of these calls and targets are code or patterns, not texts.
NOT_TEXTS = {"compile", "match", "fullmatch", "search", "sub", "findall", "split", "getLogger", "TypeVar"}


class Text(NamedTuple):
    """One text with its position."""

    path: str
    line: int
    kind: str
    text: str


def texts() -> list[Text]:
    """Return every text, sorted by file and line."""
    from_source = [text for source in sources(*PACKAGES) for text in of_source(source)]
    return sorted({*help_texts(), *from_source, *page_texts()})


# --- the command line ------------------------------------------------------------------------------------------------


def help_texts() -> Iterator[Text]:
    """Yield the help of each command, argument and option."""
    yield from _of_command(typer.main.get_command(app), "ltv-mpc")


def _of_command(command: Any, name: str) -> Iterator[Text]:
    subcommands = getattr(command, "commands", {})
    path, line = _position(command)
    yield Text(path, line, "help", f"{name}: {_joined(command.help or '')}")
    for parameter in command.params:
        if parameter.name != "help" and not getattr(parameter, "hidden", False):
            label = max(parameter.opts, key=len) if parameter.opts else parameter.name
            yield Text(path, line, "help", f"{name} {label}: {_joined(getattr(parameter, 'help', '') or '')}")
    for word, subcommand in subcommands.items():
        yield from _of_command(subcommand, f"{name} {word}")


def _position(command: Any) -> tuple[str, int]:
    function = command.callback
    while hasattr(function, "__wrapped__"):
        function = function.__wrapped__
    path = f"{function.__module__.replace('.', '/')}.py" if function is not None else "services/cli/app.py"
    return path, 0


# --- the code --------------------------------------------------------------------------------------------------------


def of_source(source: Source) -> Iterator[Text]:
    """Yield the texts of one file: errors, plots and all other sentences."""
    in_plots = source.path.startswith(PLOT_FOLDERS)
    yield from _Visitor(source, "plot" if in_plots else "text").visit_all()


class _Visitor:
    """Walk through one file that carries along the kind of text that a string would be."""

    def __init__(self, source: Source, kind: str) -> None:
        self._source = source
        self._kind = kind

    def visit_all(self) -> Iterator[Text]:
        """Yield every text of the file."""
        yield from self._visit(self._source.tree, self._kind)

    def _visit(self, node: ast.AST, kind: str) -> Iterator[Text]:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return  # a docstring
        if isinstance(node, ast.Raise) or _names_a_problem(node):
            kind = "error"
        if isinstance(node, ast.Call) and _called(node) in NOT_TEXTS:
            return
        if isinstance(node, ast.Call) and _called(node) in ("Option", "Argument", "short"):
            return  # listed as help
        if isinstance(node, ast.keyword) and node.arg in PLOT_KEYWORDS:
            kind = "plot" if kind == "text" else kind
            if isinstance(node.value, ast.Constant) and kind == "plot" and node.value.value:
                yield Text(self._source.path, node.value.lineno, kind, str(node.value.value))
                return
        literal = _literal(node)
        if literal is not None:
            if SENTENCE.search(literal):
                yield Text(self._source.path, getattr(node, "lineno", 0), kind, _joined(literal))
            if isinstance(node, ast.JoinedStr):  # texts inside the braces
                for part in node.values:
                    if isinstance(part, ast.FormattedValue):
                        yield from self._visit(part.value, kind)
            return
        for child in ast.iter_child_nodes(node):
            yield from self._visit(child, kind)


def _names_a_problem(node: ast.AST) -> bool:
    """Return True for ``problem = ...``: the text of an error that is raised a line later."""
    return isinstance(node, ast.Assign) and any(
        isinstance(target, ast.Name) and target.id in ("problem", "fault") for target in node.targets
    )


def _called(call: ast.Call) -> str:
    function = call.func
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def _literal(node: ast.AST) -> str | None:
    """Return the text of a string or f-string, with ``{expression}`` for each value; None for other nodes."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(
            str(part.value) if isinstance(part, ast.Constant) else f"{{{ast.unparse(part.value)}}}"
            for part in node.values
            if isinstance(part, ast.Constant | ast.FormattedValue)
        )
    return None


# --- pages -----------------------------------------------------------------------------------------------------------


def page_texts() -> Iterator[Text]:
    """Yield the sentences of HTML and JavaScript files."""
    for folder in PAGES:
        for path in sorted((ROOT / folder).iterdir()):
            if path.suffix in (".html", ".js"):
                yield from _of_page(path)


def _of_page(path: Path) -> Iterator[Text]:
    strings = re.compile(r"\"([^\"\n]*)\"|`([^`\n]*)`|>([^<>\n]+)<")
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        for found in strings.finditer(line.partition("// ")[0]):
            text = next(group for group in found.groups() if group is not None)
            if SENTENCE.search(text) and "default-src" not in text:
                yield Text(path.relative_to(ROOT).as_posix(), number, "page", text)


def _joined(text: str) -> str:
    return " ".join(text.split())


def main(kinds: list[str]) -> None:
    """Print the texts of these kinds, or all of them, grouped by file."""
    for path, of_file in groupby(texts(), key=lambda text: text.path):
        listed = [text for text in of_file if not kinds or text.kind in kinds]
        if listed:
            sys.stdout.write(f"\n{path}\n")
            sys.stdout.writelines(f"  {text.kind:<5} {text.line or '':>4}  {text.text}\n" for text in listed)


if __name__ == "__main__":
    main(sys.argv[1:])
