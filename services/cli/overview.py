"""Overview printed by ``ltv-mpc --help``: every command in its panel, one line each.

It replaces the help of typer, which is slower because it imports rich's Markdown. The help of each command is typer's.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator

import typer

WIDTH = 80
INDENT = 2
OPTIONS = (("--version", "Print the version, with the commit in a checkout."), ("--help, -h", "Show this list."))


def overview(app: typer.Typer, name: str, about: str) -> str:
    """Return the overview. The line of a command is the first line of its function's docstring."""
    panels: dict[str, list[tuple[str, str]]] = {}
    for panel, command, line in commands(app):
        panels.setdefault(panel, []).append((command, line))
    wide = max(len(command) for rows in panels.values() for command, _ in rows) + 2
    lines = [f"Usage: {name} COMMAND [OPTIONS] [ARGUMENTS]", "", *textwrap.wrap(about, WIDTH)]
    for panel, rows in {**panels, "Options": list(OPTIONS)}.items():
        lines += ["", f"{panel}:"]
        lines += [f"{'':{INDENT}}{command:{wide}}{line}" for command, line in rows]
    return "\n".join([*lines, "", f"{name} COMMAND --help describes a command."])


def commands(app: typer.Typer) -> Iterator[tuple[str, str, str]]:
    """Yield panel, name and first line of every command, in the order of the panels."""
    for command in app.registered_commands:
        assert command.callback is not None
        name = command.name or command.callback.__name__.replace("_", "-")
        yield str(command.rich_help_panel), name, _first_line(command.callback)
    for group in app.registered_groups:
        assert group.typer_instance is not None
        assert group.typer_instance.registered_callback is not None
        about = group.typer_instance.registered_callback.callback
        assert about is not None
        yield str(group.rich_help_panel), str(group.name), _first_line(about)


def _first_line(function: Callable[..., object]) -> str:
    return (function.__doc__ or "").strip().splitlines()[0]
