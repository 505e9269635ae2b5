"""Options that more than one command has: NAME|FILE, and short spellings of scenario keys. The bus options: ``bus.py``.

Short spellings are read as texts: the key's type says what is right, in one wording for option, --set and file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer

VehicleFile: TypeAlias = Annotated[
    str, typer.Option("--vehicle", metavar="NAME|FILE", help="The vehicle: a shipped name or a TOML file.")
]
SensorsFile: TypeAlias = Annotated[
    str, typer.Option("--sensors", metavar="NAME|FILE", help="What is mounted: a shipped name or a TOML file.")
]
ReferenceFile: TypeAlias = Annotated[
    str, typer.Option("--reference", metavar="NAME|FILE", help="Where to be: a shipped name or a TOML file.")
]
ScenarioName: TypeAlias = Annotated[
    str, typer.Argument(metavar="[SCENARIO]", help="A shipped scenario (descent, hover) or a TOML file.")
]
Out: TypeAlias = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="The one folder to write. Default runs/<UTC time>-<name>.")
]
Force: TypeAlias = Annotated[bool, typer.Option("--force", help="Write into a folder that is not empty.")]
Json: TypeAlias = Annotated[bool, typer.Option("--json", help="The result alone, as JSON, on stdout.")]


def short(name: str, key: str, metavar: str, help_: str) -> Any:
    """An option that is a short spelling of a scenario key, which its help prints."""
    return typer.Option(name, metavar=metavar, help=f"{help_} Key {key}.", rich_help_panel="Scenario keys")
