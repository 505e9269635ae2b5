"""Command line application: panels of commands, exit codes, one-line errors.

Commands import what they need inside their functions, so that help and completion stay fast.
"""

from __future__ import annotations

import os
import shutil
import sys
import textwrap
from collections.abc import Callable, Sequence
from functools import cache
from typing import Annotated

import typer
from typer.main import get_command

from ltv_mpc.errors import ConfigError
from services.cli.bus import certs, ctl, topics
from services.cli.dives import dive, localise
from services.cli.measure import campaign, profile, qp
from services.cli.options import flag
from services.cli.processes import controller, estimator, mavlink, plant, recorder, ros2, router, sensors
from services.cli.runs import log, replay, report
from services.cli.start import completion, dashboard, doctor, sim, watch
from services.cli.vehicle import vehicle
from services.runtime.console import WIDTH, escape_output, fold

PANELS: dict[str, tuple[Callable[..., object] | typer.Typer, ...]] = {
    "Start here": (sim, dashboard, watch, doctor, completion),
    "Your vehicle": (controller, vehicle, localise, topics, ctl, ros2, mavlink, dive, certs),
    "A run": (report, replay, log),
    "Measure": (profile, campaign, qp),
    "One process each": (router, plant, sensors, estimator, recorder),
}
"""Commands by panel, in the order of help."""

VERSION = "Print the version, with the commit in a checkout."
OPTIONS = {"--version": VERSION, "--help, -h": "Show this list."}

HELP = ((), ("--help",), ("-h",))
COMPLETION = "_LTV_MPC_COMPLETE"
"""Environment variable that a shell sets to request completions."""

STDERR = 2
NOT_COMPLETED = 1
BAD_INPUT = 2

app = typer.Typer(
    name="ltv-mpc",
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _panel, _commands in PANELS.items():
    for _command in _commands:
        if isinstance(_command, typer.Typer):
            app.add_typer(_command, rich_help_panel=_panel)
        else:
            app.command(rich_help_panel=_panel)(_command)


@app.callback(invoke_without_command=True)
def _about(context: typer.Context, version: Annotated[bool, flag("--version", VERSION)] = False) -> None:
    """Model predictive control of an underactuated AUV in an estimated water current, over Zenoh."""
    if version:
        from services.run.provenance import version as ours

        typer.echo(f"ltv-mpc {ours()}")
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(_overview())


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command line and exit: 0 done, 1 not completed, 2 bad input, 130 Ctrl-C."""
    _open_missing_streams()
    sys.exit(run(sys.argv[1:] if arguments is None else arguments))


def _open_missing_streams() -> None:
    """Open the null device in place of standard streams that are closed, so that no other file gets their numbers."""
    while (opened := os.open(os.devnull, os.O_RDWR)) <= STDERR:
        pass
    os.close(opened)
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "r" if number == 0 else "w", closefd=False))  # noqa: SIM115


def run(arguments: Sequence[str]) -> int:
    """Run a command line and return its exit code. Bad input gives one line on stderr and no traceback.

    Typer itself converts Ctrl-C into 130. Nothing that is printed has control characters.
    """
    escape_output()
    if tuple(arguments) in HELP and COMPLETION not in os.environ:
        typer.echo(_overview())
        return 0
    try:
        code = _tree()(list(arguments), prog_name="ltv-mpc", standalone_mode=False)
    except typer.TyperException as error:
        if not error.format_message():  # a group without a command: typer has printed its help
            return BAD_INPUT
        from services.cli.usage_errors import usage_error

        return _refuse(f"ltv-mpc: {usage_error(error, _tree(), arguments)}")
    except ConfigError as error:
        return _refuse(f"ltv-mpc: {error}")
    except BrokenPipeError:  # the reader of the output has ended: `ltv-mpc topics | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return NOT_COMPLETED
    except OSError as error:  # a full disk or a deleted folder, for example
        where = f"{error.filename}: " if error.filename else ""
        return _refuse(f"ltv-mpc: {where}{error.strerror or error}", NOT_COMPLETED)
    return code if isinstance(code, int) else 0


def _overview() -> str:
    """Return every command in its panel with the first line of its function's docstring.

    It replaces the help of typer, which is slower because it imports rich's Markdown. Each command's help is typer's.
    """
    rows = {panel: dict(map(_name_and_line, commands)) for panel, commands in PANELS.items()}
    wide = max(len(name) for lines in rows.values() for name in lines) + 2
    text = ["Usage: ltv-mpc COMMAND [OPTIONS] [ARGUMENTS]", "", *textwrap.wrap(_about.__doc__ or "", WIDTH)]
    for panel, lines in {**rows, "Options": OPTIONS}.items():
        text += ["", f"{panel}:", *(f"  {name:{wide}}{line}" for name, line in lines.items())]
    return "\n".join([*text, "", "ltv-mpc COMMAND --help describes a command."])


def _name_and_line(command: Callable[..., object] | typer.Typer) -> tuple[str, str]:
    if isinstance(command, typer.Typer):
        return str(command.info.name), str(command.info.help)
    return command.__name__.replace("_", "-"), str(command.__doc__).strip().splitlines()[0]


@cache
def _tree() -> Callable[..., object]:
    """Return the tree of all commands, built once."""
    return get_command(app)


def _refuse(text: str, code: int = BAD_INPUT) -> int:
    line = " ".join(text.split())
    if sys.stderr.isatty():
        line = fold(line, shutil.get_terminal_size().columns)
    typer.echo(line, err=True)
    return code
