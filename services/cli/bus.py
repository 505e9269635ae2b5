"""Bus options -e, -l, -m, -c, --namespace and --certs: one block, which ``with_bus`` adds to a command."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from services.cli.options import invalid, option, parameters, with_options

if TYPE_CHECKING:
    from services.bus.options import BusOptions

bus_option = partial(option, rich_help_panel="Bus options (those of Zenoh)")

Certs: TypeAlias = Annotated[
    Path | None,
    bus_option("DIR", "Use mTLS with the certificates in this folder; `ltv-mpc certs new DIR` creates them."),
]


def _block(
    connect: Annotated[
        list[str] | None,
        bus_option(
            "ENDPOINT",
            "Connect to this endpoint; repeatable. Default tcp/127.0.0.1:7447, with --certs tls/127.0.0.1:7447.",
            *("--connect", "-e"),
        ),
    ] = None,
    listen: Annotated[
        list[str] | None, bus_option("ENDPOINT", "Listen on this endpoint as the router; repeatable.", "--listen", "-l")
    ] = None,
    mode: Annotated[str | None, bus_option("MODE", "client, peer or router.", "--mode", "-m")] = None,
    config: Annotated[
        Path | None,
        bus_option("FILE", "Zenoh configuration file (JSON5). Default: $ZENOH_CONFIG, if it is set.", "--config", "-c"),
    ] = None,
    namespace: Annotated[str, bus_option("NAME", "Prefix of every key: one for each vehicle.")] = "",
    certs: Certs = None,
) -> None:
    """Declare the bus options."""


def _collect(
    connect: list[str] | None, listen: list[str] | None, certs: Path | None, *, role: str, **more: Any
) -> BusOptions:
    """Check the bus options and return them as one. ``role`` selects the certificate. Raises ``ConfigError``."""
    from msgspec import structs

    from ltv_mpc.config import parse, read_text
    from services.bus.options import BusOptions
    from services.bus.session import configuration

    for name, endpoints in (("--connect", connect), ("--listen", listen)):
        for endpoint in endpoints or ():
            check_endpoint(name, endpoint, certs)
    if (config := more.pop("config")) is not None:
        read_text(config, what="Zenoh configuration")
    check_namespace(more["namespace"])
    parsed = parse({"connect": connect or (), "listen": listen or (), **more}, BusOptions, source="option --mode")
    options = structs.replace(parsed, config=config, certs=certs, role=role)
    configuration(options)  # Zenoh checks the options before any file is written or process started
    return options


def with_bus(role: str = "") -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Add the bus options to a command, which receives them as its parameter ``bus``.

    ``role`` selects the certificate that the command uses with --certs.
    """
    block, collect = parameters(_block), partial(_collect, role=role)
    return lambda function: with_options(function, block, "bus", collect)


def check_endpoint(option: str, endpoint: str, certs: Path | None) -> None:
    """Raise ``ConfigError`` if Zenoh cannot use the endpoint, or if it is not secure although certificates are used."""
    from services.bus.options import SECURE, endpoint_error

    if problem := endpoint_error(endpoint):
        raise invalid(f"option {option}", problem, value=endpoint)
    if certs is not None and not endpoint.startswith(f"{SECURE}/"):
        raise invalid(f"option {option}", f"must be {SECURE}/HOST:PORT with --certs", value=endpoint)


def check_namespace(namespace: str, option: str = "--namespace") -> None:
    """Raise ``ConfigError`` if the namespace cannot be the prefix of a key."""
    if (namespace and not all(namespace.split("/"))) or set(namespace) & set("*$#? "):
        problem = "must be names joined by /, without * $ # ? or spaces"
        raise invalid(f"option {option}", problem, value=namespace)
