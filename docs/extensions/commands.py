"""Every command with its arguments and options, from the command line itself: where a page says ``<!-- commands -->``.

As Markdown, so that the page has headings of its own and a line's help reads as it does in a terminal.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from typer.core import TyperGroup
from typer.main import get_command

if TYPE_CHECKING:
    from sphinx.application import Sphinx

MARK = "<!-- commands -->"


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx's entry."""
    app.connect("source-read", _fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _fill(_app: Sphinx, _page: str, source: list[str]) -> None:
    if MARK in source[0]:
        source[0] = source[0].replace(MARK, "\n".join(page()))


def page() -> Iterator[str]:
    """Yield a section for each command, under a heading for each panel."""
    from services.cli.app import app

    panels: dict[str, list[str]] = {}
    for words, command in commands(get_command(app), ()):
        if len(words) == 1:
            panel = panels.setdefault(command.rich_help_panel, [])
        if not isinstance(command, TyperGroup):
            panel += section(" ".join(words), command)
    for name, sections in panels.items():
        yield f"## {name}\n"
        yield from sections


def commands(command: Any, words: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command below ``command`` by its words, in the order of help."""
    for name, inner in command.commands.items():
        yield (*words, name), inner
        if isinstance(inner, TyperGroup):
            yield from commands(inner, (*words, name))


def section(name: str, command: Any) -> Iterator[str]:
    """One command: usage, what it does, its arguments and options."""
    arguments = [parameter for parameter in command.params if parameter.param_type_name == "argument"]
    options = [parameter for parameter in command.params if parameter.param_type_name == "option"]
    usage = " ".join(filter(None, (f"ltv-mpc {name}", *map(called, arguments), "[OPTIONS]" if options else "")))
    yield f"### ltv-mpc {name}\n"
    yield f"```text\n{usage}\n```\n"
    yield f"{prose(inspect.cleandoc(command.help or ''))}\n"
    if command.params:
        yield "| | | default |\n|---|---|---|"
        for parameter in (*arguments, *options):
            cells = (f"`{spelled(parameter)}`", prose(parameter.help or ""), default(parameter))
            yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
        yield ""


def called(argument: Any) -> str:
    """Return an argument as it stands in the line of usage."""
    return str(argument.metavar or argument.name.upper())


def spelled(parameter: Any) -> str:
    """``--connect, -e ENDPOINT``."""
    if parameter.param_type_name == "argument":
        return called(parameter)
    names = ", ".join((*parameter.opts, *parameter.secondary_opts))
    return names if parameter.is_flag else f"{names} {parameter.metavar or parameter.name.upper()}"


def default(parameter: Any) -> str:
    """Return the text of a parameter's default."""
    shown, value = parameter.show_default, parameter.default
    if isinstance(shown, str):
        return shown
    if shown is False or value in (None, False, "") or callable(value):
        return "required" if parameter.required else ""
    return f"`{value}`"


def prose(words: str) -> str:
    """Help as Markdown: a star or an angle bracket is itself."""
    return words.replace("``", "`").replace("*", r"\*").replace("<", r"\<")
