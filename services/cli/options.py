"""Options: how one is declared, those that several commands share, and how a command gets more of them.

The bus options -e, -l, -m, -c, --namespace and --certs are one block, which ``with_bus`` adds to a command.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_type_hints

import typer

from ltv_mpc.errors import ConfigError

if TYPE_CHECKING:
    from ltv_mpc.control.config import ResolvedConfig
    from ltv_mpc.vehicle.parameters import Vehicle
    from services.bus.options import BusOptions as BusOptions
else:
    BusOptions = Any  # help imports no types: it stays fast


def option(metavar: str, help_: str, *names: str, **more: Any) -> Any:
    """Return an option with a value; its name is that of the parameter, if none is given. ``more``: min, max."""
    return typer.Option(*names, metavar=metavar, help=help_, **more)


def flag(name: str, help_: str, **more: Any) -> Any:
    """Return an option without a value."""
    return typer.Option(name, help=help_, **more)


def argument(metavar: str, help_: str, **more: Any) -> Any:
    """Return a positional argument."""
    return typer.Argument(metavar=metavar, help=help_, **more)


def group(name: str, about: str) -> typer.Typer:
    """Return a command with commands of its own, to which ``command`` adds one."""
    names = {"help_option_names": ["-h", "--help"]}
    made = typer.Typer(name=name, no_args_is_help=True, context_settings=names, help=about)
    made.callback()(lambda: None)  # also with a single command it is a group
    return made


VehicleFile: TypeAlias = Annotated[str, option("NAME|FILE", "Vehicle: a shipped name or a TOML file.")]
ShownVehicle: TypeAlias = Annotated[
    str | None, option("NAME|FILE", "Vehicle whose thrust limits are shown. Default: none.")
]
SensorsFile: TypeAlias = Annotated[str, option("NAME|FILE", "Sensors: a shipped name or a TOML file.")]
ControllerSettings: TypeAlias = Annotated[
    Path | None, option("FILE", "TOML file with keys of [controller], without that header.")
]
ScenarioName: TypeAlias = Annotated[
    str,
    argument("SCENARIO", "Shipped name (demo, descent, hover, paper-5s, paper-2.5s, paper-no-control) or a TOML file."),
]
FenceFile: TypeAlias = Annotated[str | None, option("FILE", "Keep-in and keep-out zones, docs/fences.md.")]
Out: TypeAlias = Annotated[Path | None, option("DIR", "Folder to write. Default: runs/TIME-NAME (UTC).")]
Force: TypeAlias = Annotated[bool, flag("--force", "Write into a folder that is not empty.")]
LogJson: TypeAlias = Annotated[
    bool, flag("--log-json", "Print each line on stderr as a JSON object, for a log collector.")
]
Json: TypeAlias = Annotated[bool, flag("--json", "Print only the result, as JSON, on stdout.")]


def invalid(source: str, problem: str, *, value: object = None) -> ConfigError:
    """Return the error of an option or argument, for which the command ends with exit code 2."""
    return ConfigError(source, "", problem, value=value)


@contextmanager
def needs(package: str, extra: str, command: str) -> Iterator[None]:
    """Raise ``ConfigError`` if an import within needs a package that is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != package:
            raise
        problem = f"needs the package {package}: pip install {package} (extra {extra})"
        raise invalid(f"ltv-mpc {command}", problem) from None


@contextmanager
def plots_or_a_line(what: str, *, wanted: bool = False) -> Iterator[None]:
    """Say in one line why there are no plots, if plotly is not installed; exit with code 1 if they are ``wanted``."""
    from services.reporting.static_files import NoPlotly

    try:
        yield
    except NoPlotly as missing:
        typer.echo(f"{what}: {missing}", err=True)
        if wanted:
            raise typer.Exit(1) from None


def resolved(vehicle: Vehicle, settings: Path | None, **given: float | None) -> ResolvedConfig:
    """Return the controller's settings, in which a given value replaces that of the file. Raises ``ConfigError``."""
    from msgspec.structs import replace

    from ltv_mpc.control.config import ControllerConfig
    from ltv_mpc.control.resolution import settled

    control = ControllerConfig() if settings is None else ControllerConfig.load(str(settings))
    control = replace(control, **{name: value for name, value in given.items() if value is not None})
    source = "options --rate-hz, --horizon-s" if settings is None else f"controller settings {settings}"
    return settled(control, vehicle, source=source)


def show(result: object, text: Callable[[], str], *, as_json: bool) -> str:
    """Print a result on stdout as text or as JSON; return the JSON."""
    import msgspec

    plain = msgspec.json.format(msgspec.json.encode(result), indent=2).decode()
    typer.echo(plain if as_json else text())
    return plain


def parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """Return the parameters of a function by keyword, with types."""
    types = get_type_hints(function, include_extras=True)
    return [
        one.replace(annotation=types[one.name], kind=inspect.Parameter.KEYWORD_ONLY)
        for one in inspect.signature(function).parameters.values()
    ]


def with_options(
    function: Callable[..., int], block: Sequence[inspect.Parameter], name: str, collect: Callable[..., Any]
) -> Callable[..., int]:
    """Return a command with the options of ``block``, of which ``collect`` makes its parameter ``name``."""
    own = [one for one in parameters(function) if one.name != name]

    def command(**given: Any) -> int:
        collected = collect(**{one.name: given.pop(one.name) for one in block})
        return function(**given, **{name: collected})

    command.__name__, command.__doc__, command.__module__ = function.__name__, function.__doc__, function.__module__
    command.__annotations__ = {one.name: one.annotation for one in (*own, *block)} | {"return": int}
    command.__signature__ = inspect.Signature([*own, *block])  # type: ignore[attr-defined]
    return command


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
