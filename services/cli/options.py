"""Options: how one is declared, those that several commands share, and how a command gets more of them.

The bus options -e, -l, -m, -c, --namespace and --certs are one block, which ``with_bus`` adds to a command.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_args, get_origin, get_type_hints

import typer
from msgspec import structs

from services.bus.options import SECURE, check_namespace, endpoint_error
from services.bus.options import BusOptions as BusOptions
from services.bus.options import invalid as invalid
from services.processes.settings import Controller, Estimator, Plant


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


def options_of(struct: type[Any], panel: str | None = None) -> list[inspect.Parameter]:
    """Return the options of a struct: each field that ``services.bus.options.setting`` describes."""
    made = []
    for field in structs.fields(struct):
        for annotated in (kind for kind in (field.type, *get_args(field.type)) if get_origin(kind) is Annotated):
            kind, meta = get_args(annotated)
            names, default = (f"--{field.name.replace('_', '-')}", *meta.extra["names"]), field.default
            if kind == tuple[str, ...]:
                kind, default = list[str], None
            common = {"metavar": meta.extra["metavar"], "help": meta.description, "min": meta.ge, "max": meta.le}
            declared = (
                typer.Argument(**common)
                if meta.extra["argument"]
                else typer.Option(*names, **common, rich_help_panel=panel)
            )
            one = inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=default)
            made.append(one.replace(annotation=Annotated[kind, declared]))
    return made


def option_of(struct: type[Any], name: str, panel: str | None = None) -> Any:
    """Return the option or argument of one field of a struct, for a command that has the same one."""
    return next(get_args(one.annotation)[1] for one in options_of(struct, panel) if one.name == name)


VehicleFile: TypeAlias = Annotated[str, option_of(Controller, "vehicle")]
ShownVehicle: TypeAlias = Annotated[
    str | None, option("NAME|FILE", "Vehicle whose thrust limits are shown. Default: none.")
]
SensorsFile: TypeAlias = Annotated[str, option_of(Estimator, "sensors")]
ControllerSettings: TypeAlias = Annotated[Path | None, option_of(Controller, "settings")]
ScenarioName: TypeAlias = Annotated[str, option_of(Plant, "scenario")]
FenceFile: TypeAlias = Annotated[str | None, option_of(Controller, "fence")]
Out: TypeAlias = Annotated[Path | None, option("DIR", "Folder to write. Default: runs/TIME-NAME (UTC).")]
Force: TypeAlias = Annotated[bool, flag("--force", "Write into a folder that is not empty.")]
Json: TypeAlias = Annotated[bool, flag("--json", "Print only the result, as JSON, on stdout.")]


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


def show(result: object, text: Callable[[], str], *, as_json: bool, file: Path | None = None) -> None:
    """Print a result on stdout as text or as JSON, and write the JSON into a file, whose folder is printed last."""
    import msgspec

    plain = msgspec.json.format(msgspec.json.encode(result), indent=2).decode()
    typer.echo(plain if as_json else text())
    if file is not None:
        file.write_text(plain + "\n", encoding="utf-8")
        typer.echo(str(file.parent), err=as_json)


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


BUS_PANEL = "Bus options (those of Zenoh)"

Certs: TypeAlias = Annotated[Path | None, option_of(BusOptions, "certs", BUS_PANEL)]


def _struct_of(struct: type[Any], **given: Any) -> Any:
    """Return the struct of the options that are given."""
    plain = {name: tuple(value) if isinstance(value, list) else value for name, value in given.items()}
    return struct(**{name: value for name, value in plain.items() if value is not None})


def _checked(*, role: str, **given: Any) -> BusOptions:
    """Check the bus options and return them as one. ``role`` selects the certificate. Raises ``ConfigError``."""
    from ltv_mpc.config import read_text
    from services.bus.session import configuration

    options: BusOptions = _struct_of(BusOptions, **given, role=role)
    for name, endpoints in (("--connect", options.connect), ("--listen", options.listen)):
        for endpoint in endpoints:
            check_endpoint(name, endpoint, options.certs)
    if options.config is not None:
        read_text(options.config, what="Zenoh configuration")
    check_namespace(options.namespace)
    configuration(options)  # Zenoh checks the options before any file is written or process started
    return options


def with_bus(role: str = "") -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Add the bus options to a command, which receives them as its parameter ``bus``.

    ``role`` selects the certificate that the command uses with --certs.
    """
    block, collect = options_of(BusOptions, BUS_PANEL), partial(_checked, role=role)
    return lambda function: with_options(function, block, "bus", collect)


def process_command(settings: type[Any], package: str = "") -> Callable[..., int]:
    """Return the command of a process, named after the struct of its settings, which are its options.

    ``package`` is that of an extra, which has the command's name.
    """
    name = settings.__name__.lower()

    def command(given: dict[str, Any], bus: BusOptions) -> int:
        with needs(package, name, name):
            process = importlib.import_module(f"services.processes.{name}")
        code: int = process.main(_struct_of(settings, **given, bus=bus))
        return code

    command.__name__, command.__doc__ = name, settings.__doc__
    return with_bus(name)(with_options(command, options_of(settings), "given", dict))


def check_endpoint(option: str, endpoint: str, certs: Path | None) -> None:
    """Raise ``ConfigError`` if Zenoh cannot use the endpoint, or if it is not secure although certificates are used."""
    if problem := endpoint_error(endpoint):
        raise invalid(f"option {option}", problem, value=endpoint)
    if certs is not None and not endpoint.startswith(f"{SECURE}/"):
        raise invalid(f"option {option}", f"must be {SECURE}/HOST:PORT with --certs", value=endpoint)
