"""Options: how one is declared, those that several commands share, and how a command gets more of them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_type_hints

import typer

from ltv_mpc.errors import ConfigError


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
ReferenceFile: TypeAlias = Annotated[str, option("NAME|FILE", "Path or point to follow, docs/references.md.")]
ScenarioName: TypeAlias = Annotated[
    str,
    argument("SCENARIO", "Shipped name (demo, descent, hover, paper-5s, paper-2.5s, paper-no-control) or a TOML file."),
]
FenceFile: TypeAlias = Annotated[str | None, option("FILE", "Keep-in and keep-out zones, docs/fences.md.")]
BathymetryFile: TypeAlias = Annotated[
    str | None, option("FILE", "Soundings of the bottom: CSV, docs/motion-limits.md.")
]
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


def show(result: object, text: Callable[[], str], *, as_json: bool) -> str:
    """Print a result on stdout as text or as JSON; return the JSON."""
    import msgspec

    plain = msgspec.json.format(msgspec.json.encode(result), indent=2).decode()
    typer.echo(plain if as_json else text())
    return plain


def parameters(function: Callable[..., Any], **unknown: Any) -> list[inspect.Parameter]:
    """Return the parameters of a function by keyword, with types; ``unknown`` has types that are not imported."""
    types = get_type_hints(function, localns=unknown, include_extras=True)
    return [
        one.replace(annotation=types[one.name], kind=inspect.Parameter.KEYWORD_ONLY)
        for one in inspect.signature(function).parameters.values()
    ]


def with_options(
    function: Callable[..., int], block: Sequence[inspect.Parameter], name: str, collect: Callable[..., Any]
) -> Callable[..., int]:
    """Return a command with the options of ``block``, of which ``collect`` makes its parameter ``name``."""
    # The parameter's own type is not imported: help stays fast.
    own = [one for one in parameters(function, BusOptions=Any) if one.name != name]

    def command(**given: Any) -> int:
        collected = collect(**{one.name: given.pop(one.name) for one in block})
        return function(**given, **{name: collected})

    command.__name__, command.__doc__, command.__module__ = function.__name__, function.__doc__, function.__module__
    command.__annotations__ = {one.name: one.annotation for one in (*own, *block)} | {"return": int}
    command.__signature__ = inspect.Signature([*own, *block])  # type: ignore[attr-defined]
    return command
