"""Options shared by several commands: NAME|FILE, short options for scenario keys. ``bus.py`` has the bus options.

Short options are read as text and checked by the type of their key, so that option, --set and file give the same error.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

VehicleFile: TypeAlias = Annotated[
    str, typer.Option("--vehicle", metavar="NAME|FILE", help="Vehicle: a shipped name or a TOML file.")
]
ShownVehicle: TypeAlias = Annotated[
    str | None,
    typer.Option("--vehicle", metavar="NAME|FILE", help="Vehicle whose thrust limits are shown. Default: none."),
]
SensorsFile: TypeAlias = Annotated[
    str, typer.Option("--sensors", metavar="NAME|FILE", help="Sensors: a shipped name or a TOML file.")
]
ControllerSettings: TypeAlias = Annotated[
    Path | None,
    typer.Option("--settings", metavar="FILE", help="TOML file with keys of [controller], without that header."),
]
ReferenceFile: TypeAlias = Annotated[
    str, typer.Option("--reference", metavar="NAME|FILE", help="Path or point to follow, docs/references.md.")
]
ScenarioName: TypeAlias = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="Shipped name (demo, descent, hover, paper-5s, paper-2.5s, paper-no-control) or a TOML file.",
    ),
]
FenceFile: TypeAlias = Annotated[
    str | None,
    typer.Option("--fence", metavar="FILE", help="Keep-in and keep-out zones, docs/fences.md."),
]
BathymetryFile: TypeAlias = Annotated[
    str | None,
    typer.Option("--bathymetry", metavar="FILE", help="Soundings of the bottom: CSV, docs/motion-limits.md."),
]
Out: TypeAlias = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Folder to write. Default: runs/TIME-NAME (UTC)."),
]
CampaignFolder: TypeAlias = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Folder of the campaign; an interrupted one in it is continued."),
]
Force: TypeAlias = Annotated[bool, typer.Option("--force", help="Write into a folder that is not empty.")]
LogJson: TypeAlias = Annotated[
    bool, typer.Option("--log-json", help="Print each line on stderr as a JSON object, for a log collector.")
]
Json: TypeAlias = Annotated[bool, typer.Option("--json", help="Print only the result, as JSON, on stdout.")]
