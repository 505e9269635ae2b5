"""Overview printed by ``ltv-mpc --help``: every command in its panel, one line each.

It replaces the help of typer, which is slower because it imports rich's Markdown. The help of each command is typer's.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping

import typer

WIDTH = 80
INDENT = 2
OPTIONS = {"--version": "Print the version, with the commit in a checkout.", "--help, -h": "Show this list."}


def overview(panels: Mapping[str, Iterable[Callable[..., object] | typer.Typer]], program: str, about: str) -> str:
    """Return the overview. The line of a command is the first line of its function's docstring."""
    rows = {panel: dict(map(_name_and_line, commands)) for panel, commands in panels.items()}
    wide = max(len(name) for lines in rows.values() for name in lines) + 2
    text = [f"Usage: {program} COMMAND [OPTIONS] [ARGUMENTS]", "", *textwrap.wrap(about, WIDTH)]
    for panel, lines in {**rows, "Options": OPTIONS}.items():
        text += ["", f"{panel}:", *(f"{'':{INDENT}}{name:{wide}}{line}" for name, line in lines.items())]
    return "\n".join([*text, "", f"{program} COMMAND --help describes a command."])


def _name_and_line(command: Callable[..., object] | typer.Typer) -> tuple[str, str]:
    if isinstance(command, typer.Typer):
        return str(command.info.name), str(command.info.help)
    return command.__name__.replace("_", "-"), str(command.__doc__).strip().splitlines()[0]
