"""Options that more than one command has: the bus block, NAME|FILE, and short spellings of scenario keys.

Short spellings are read as texts: the key's type says what is right, in one wording for option, --set and file.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

if TYPE_CHECKING:
    from services.bus.session import BusOptions

BUS = "Bus options, as Zenoh's"

Connect: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--connect",
        "-e",
        metavar="ENDPOINT",
        help="Connect to this endpoint; repeatable. Default tcp/127.0.0.1:7447.",
        rich_help_panel=BUS,
    ),
]
Listen: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--listen",
        "-l",
        metavar="ENDPOINT",
        help="Listen on this endpoint and be the router; repeatable.",
        rich_help_panel=BUS,
    ),
]
Mode: TypeAlias = Annotated[
    str | None,
    typer.Option("--mode", "-m", metavar="MODE", help="client, peer or router.", rich_help_panel=BUS),
]
ZenohConfig: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--config",
        "-c",
        metavar="FILE",
        help="A Zenoh configuration (JSON5). Default: $ZENOH_CONFIG where it is set.",
        rich_help_panel=BUS,
    ),
]
Namespace: TypeAlias = Annotated[
    str,
    typer.Option("--namespace", metavar="NAME", help="Put before every key: one per vehicle.", rich_help_panel=BUS),
]
Certs: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--certs",
        metavar="DIR",
        help="mTLS with the certificates in this folder, which `ltv-mpc certs new DIR` makes.",
        rich_help_panel=BUS,
    ),
]

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


def bus(
    connect: list[str] | None,
    listen: list[str] | None,
    mode: str | None,
    config: Path | None,
    namespace: str,
    certs: Path | None = None,
    *,
    role: str = "",
) -> BusOptions:
    """The bus options as one, checked. ``role`` is whose certificate is shown with --certs. Raises ``ConfigError``."""
    from msgspec import structs

    from ltv_mpc.config import parse, read_text
    from ltv_mpc.errors import ConfigError
    from services.bus.session import SECURE, BusOptions, configuration, fault_of

    for name, endpoints in (("--connect", connect), ("--listen", listen)):
        for endpoint in endpoints or ():
            if problem := fault_of(endpoint):
                raise ConfigError(f"option {name}", "", problem, value=endpoint)
            if certs is not None and not endpoint.startswith(f"{SECURE}/"):
                raise ConfigError(f"option {name}", "", f"must be {SECURE}/HOST:PORT with --certs", value=endpoint)
    if config is not None:
        read_text(config, what="Zenoh configuration")
    if (namespace and not all(namespace.split("/"))) or set(namespace) & set("*$#? "):
        raise ConfigError(
            "option --namespace", "", "must be names joined by /, without * $ # ? or spaces", value=namespace
        )
    table = {"connect": connect or (), "listen": listen or (), "mode": mode, "namespace": namespace}
    parsed = parse(table, BusOptions, source="option --mode")
    options = structs.replace(parsed, config=config, certs=certs, role=role)
    configuration(options)  # Zenoh's own word, before anything is made or started
    return options
