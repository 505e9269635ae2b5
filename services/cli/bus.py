"""Bus options -e, -l, -m, -c, --namespace and --certs: one block, which ``with_bus`` adds to a command."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_type_hints

import typer

from ltv_mpc.errors import ConfigError

if TYPE_CHECKING:
    from services.bus.options import BusOptions

PANEL = "Bus options (those of Zenoh)"

Certs: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--certs",
        metavar="DIR",
        help="Use mTLS with the certificates in this folder; `ltv-mpc certs new DIR` creates them.",
        rich_help_panel=PANEL,
    ),
]


Namespace: TypeAlias = Annotated[
    str,
    typer.Option(
        "--namespace", metavar="NAME", help="Prefix of every key: one for each vehicle.", rich_help_panel=PANEL
    ),
]


def _block(
    connect: Annotated[
        list[str] | None,
        typer.Option(
            "--connect",
            "-e",
            metavar="ENDPOINT",
            help="Connect to this endpoint; repeatable. Default tcp/127.0.0.1:7447, with --certs tls/127.0.0.1:7447.",
            rich_help_panel=PANEL,
        ),
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(
            "--listen",
            "-l",
            metavar="ENDPOINT",
            help="Listen on this endpoint as the router; repeatable.",
            rich_help_panel=PANEL,
        ),
    ] = None,
    mode: Annotated[
        str | None, typer.Option("--mode", "-m", metavar="MODE", help="client, peer or router.", rich_help_panel=PANEL)
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            "-c",
            metavar="FILE",
            help="Zenoh configuration file (JSON5). Default: $ZENOH_CONFIG, if it is set.",
            rich_help_panel=PANEL,
        ),
    ] = None,
    namespace: Namespace = "",
    certs: Certs = None,
    *,
    role: str = "",
) -> BusOptions:
    """Check the bus options and return them as one. ``role`` selects the certificate. Raises ``ConfigError``."""
    from msgspec import structs

    from ltv_mpc.config import parse, read_text
    from services.bus.options import BusOptions
    from services.bus.session import configuration

    for name, endpoints in (("--connect", connect), ("--listen", listen)):
        for endpoint in endpoints or ():
            check_endpoint(name, endpoint, certs)
    if config is not None:
        read_text(config, what="Zenoh configuration")
    check_namespace(namespace)
    table = {"connect": connect or (), "listen": listen or (), "mode": mode, "namespace": namespace}
    parsed = parse(table, BusOptions, source="option --mode")
    options = structs.replace(parsed, config=config, certs=certs, role=role)
    configuration(options)  # Zenoh checks the options before any file is written or process started
    return options


def with_bus(role: str = "") -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Add the bus options to a command, which receives them as its parameter ``bus``.

    ``role`` selects the certificate that the command uses with --certs.
    """

    def decorate(function: Callable[..., int]) -> Callable[..., int]:
        block = [option for option in _parameters(_block) if option.name != "role"]

        def command(**given: Any) -> int:
            bus = _block(**{option.name: given.pop(option.name) for option in block}, role=role)
            return function(**given, bus=bus)

        parameters = [*(own for own in _parameters(function) if own.name != "bus"), *block]
        command.__name__, command.__doc__ = function.__name__, function.__doc__
        command.__module__ = function.__module__
        command.__annotations__ = {option.name: option.annotation for option in parameters} | {"return": int}
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        return command

    return decorate


def check_endpoint(option: str, endpoint: str, certs: Path | None) -> None:
    """Raise ``ConfigError`` if Zenoh cannot use the endpoint, or if it is not secure although certificates are used."""
    from services.bus.options import SECURE, endpoint_error

    if problem := endpoint_error(endpoint):
        raise ConfigError(f"option {option}", "", problem, value=endpoint)
    if certs is not None and not endpoint.startswith(f"{SECURE}/"):
        raise ConfigError(f"option {option}", "", f"must be {SECURE}/HOST:PORT with --certs", value=endpoint)


def check_namespace(namespace: str, option: str = "--namespace") -> None:
    """Raise ``ConfigError`` if the namespace cannot be the prefix of a key."""
    if (namespace and not all(namespace.split("/"))) or set(namespace) & set("*$#? "):
        problem = "must be names joined by /, without * $ # ? or spaces"
        raise ConfigError(f"option {option}", "", problem, value=namespace)


def _parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """Return the parameters of a function with resolved annotations, without importing ``BusOptions``."""
    types = get_type_hints(function, localns={"BusOptions": Any}, include_extras=True)
    return [
        one.replace(annotation=types[one.name], kind=inspect.Parameter.KEYWORD_ONLY)
        for one in inspect.signature(function).parameters.values()
    ]
