"""Panel "Start here": ``sim``, ``dashboard``, ``watch``, ``doctor`` and ``completion``."""

from __future__ import annotations

import inspect
import ipaddress
import os
import shlex
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from services.cli.options import (
    BusOptions,
    Certs,
    Force,
    Json,
    Out,
    ScenarioName,
    ShownVehicle,
    flag,
    invalid,
    option,
    show,
    with_bus,
    with_options,
)
from services.runtime.console import fold

if TYPE_CHECKING:
    from services.run.folder import RunFolder
    from services.run.run_config import Override, RunConfig
    from services.runtime.stopping import StopRequest
    from sim.evaluation.summary import Summary


NO_JIT = "NUMBA_DISABLE_JIT"

KEYS = {
    "speed": ("run.speed", "X", "Vehicle time per real time."),
    "seed": ("run.seed", "N", "Seed of all random draws."),
    "duration_s": ("run.duration_s", "T", "Duration after the surface phase."),
    "horizon_s": ("controller.horizon_s", "H", "Horizon of the controller; default: proposed by `vehicle check`."),
    "compute_delay_s": ("run.compute_delay_s", "D", "Delay added to that of the controller."),
    "currents": ("water.file", "FILE.csv", "Measured current profile (depth_m, v_north_mps, u_east_mps)."),
    "water_prior": ("estimator.water_prior", "FILE.csv", "Current known to the estimator: a run's currents.csv."),
    "sensors": ("sensors", "NAME|FILE", "Sensors: paper, realistic, or a TOML file."),
    "vehicle": ("vehicle", "NAME|FILE", "Vehicle: paper, or a TOML file."),
    "reference": ("reference", "NAME|FILE", "Reference: a shipped name or a TOML file."),
    "surface_time_s": ("run.surface_time_s", "S", "Time at the surface before the descent."),
    "perfect_state": ("run.perfect_state=true", "", "Give the true state to the controller."),
    "no_control": ("controller.lateral=false", "", "Keep the lateral thrusts at zero."),
}
"""Options of scenario keys: key, value in help, help. Their values are read as text and checked by the type of the key,
so that option, --set and file give the same error; an option without a value sets the one that is given here.
"""


def _key_options() -> list[inspect.Parameter]:
    made = []
    for name, (key, value, help_) in KEYS.items():
        text, panel = f"{help_} Key {key.partition('=')[0]}.", {"rich_help_panel": "Scenario keys"}
        kind: Any
        if value:
            kind = Annotated[str | None, option(value, text, **panel)]
        else:
            kind = Annotated[bool, flag(_option(name), text, **panel)]
        default = None if value else False
        made.append(inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind))
    return made


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def with_keys(function: Callable[..., int]) -> Callable[..., int]:
    """Add the options of ``KEYS`` to a command, which receives them by name as its parameter ``given``."""
    return with_options(function, _key_options(), "given", dict)


@with_keys
def sim(
    scenario: ScenarioName = "demo",
    lockstep: Annotated[
        bool, flag("--lockstep", "Run in one process on a simulated clock, as fast as the machine allows.")
    ] = False,
    set_: Annotated[
        list[str] | None, option("KEY=VALUE", "Set any key of the scenario; repeatable.", "--set", show_default=False)
    ] = None,
    dashboard: Annotated[
        bool | None,
        flag("--dashboard/--no-dashboard", "Serve a live page and print its address. Default: on a terminal."),
    ] = None,
    open_: Annotated[bool, flag("--open", "Open the live page in a browser.")] = False,
    certs: Certs = None,
    as_json: Json = False,
    force: Force = False,
    out: Out = None,
    *,
    given: Mapping[str, Any],
) -> int:
    """Run a scenario as processes, or in lock step.

    Precedence: option, --set, file, default.
    """
    if not lockstep:
        _interpret()
    from services.run import folder
    from services.run.host_resources import check_disk_space, check_open_files
    from services.run.run_config import resolve
    from services.runtime.stopping import hang_up_with_stderr

    overrides = _overrides(set_ or (), given)
    if lockstep:
        _refuse_beside_lockstep(overrides, {"--dashboard": dashboard, "--open": open_, "--certs": certs})
    if given["perfect_state"] and given["water_prior"] is not None:
        raise invalid("option --water-prior", "cannot act together with --perfect-state: nothing is estimated")
    run_config = resolve(scenario, overrides)
    if certs is not None:
        _check_certs(certs, run_config)
    check_open_files()
    check_disk_space(out or folder.ROOT, run_config.scenario.run.surface_time_s + run_config.scenario.run.duration_s)
    with folder.reserve(run_config.name, run_config.files, out=out, force=force) as run_folder, hang_up_with_stderr():
        for note in run_config.notes:
            typer.echo(note, err=True)
        if lockstep:
            return _run_in_lockstep(run_config, run_folder, as_json)
        page = open_ or (sys.stderr.isatty() if dashboard is None else dashboard)
        return _run_processes(run_config, run_folder, as_json, certs, page=page, open_browser=open_)


def _interpret() -> None:
    """Load compiled functions as plain Python: this process calls few of them, and to load them takes longer.

    In a fresh checkout they would be compiled before the live page's address is known.
    """
    before = os.environ.get(NO_JIT)
    os.environ[NO_JIT] = "1"
    import ltv_mpc.jit  # noqa: F401  (reads it; no effect if it is imported already)

    del os.environ[NO_JIT]  # the processes of the run use compiled code
    if before is not None:
        os.environ[NO_JIT] = before


def _overrides(assignments: Sequence[str], given: Mapping[str, Any]) -> list[Override]:
    """Return the overrides in the order of their precedence, the last one wins: --set, then the options."""
    from services.run.run_config import Override

    overrides = [Override("option --set", assignments)] if assignments else []
    for name, value in given.items():
        if value is not None and value is not False:
            key = KEYS[name][0]
            kind = ["water.kind=measured"] if name == "currents" else []
            overrides.append(Override(f"option {_option(name)}", [*kind, key if value is True else f"{key}={value}"]))
    return overrides


def _refuse_beside_lockstep(overrides: Sequence[Override], others: Mapping[str, object]) -> None:
    """Raise ``ConfigError`` for an option that has no effect in lock step."""
    for source, assignments in overrides:
        if any(text.partition("=")[0].strip() == KEYS["speed"][0] for text in assignments):
            problem = "cannot act together with --lockstep, which runs as fast as the machine allows: leave one out"
            raise invalid(f"{source}{': run.speed' if source == 'option --set' else ''}", problem)
    for name, value in others.items():
        if value:
            problem = "cannot act together with --lockstep, which publishes no messages"
            raise invalid(f"option {name}", f"{problem}: report.html shows the run afterwards")


def _check_certs(certs: Path, run_config: RunConfig) -> None:
    """Check that each process of the run has its own certificate. Raises ``ConfigError``."""
    from services.bus.roles import SUPERVISOR
    from services.bus.security import credentials
    from services.supervisor import process_table

    if run_config.scenario.run.perfect_state:
        problem = "cannot act together with run.perfect_state, in which the sensors publish the estimate themselves"
        raise invalid("option --certs", problem)
    for role in (SUPERVISOR, *(row.name for row in process_table.processes(run_config.scenario))):
        credentials(certs, role)


def _run_in_lockstep(run_config: RunConfig, folder: RunFolder, as_json: bool) -> int:
    from services.reporting.terminal import progress_bar
    from services.runtime.stopping import DONE, FAILED, INTERRUPTED, stop_on_signals
    from services.tools import lockstep_run

    scenario = run_config.scenario
    with stop_on_signals() as request:
        compiled = _compile(folder, request)
        if compiled is not None:
            return compiled
        try:
            with progress_bar(scenario.title) as progress:
                summary = lockstep_run.run(run_config, folder, progress=progress, stop=request)
        except lockstep_run.NotStored as failure:
            typer.echo(f"{folder.path}: the run cannot be stored: {failure.strerror}", err=True)
            _print_summary(failure.summary, folder, as_json)
            return FAILED
    _print_summary(summary, folder, as_json)
    if summary.duration_s >= scenario.run.duration_s:
        return DONE
    if request():
        typer.echo("stopped early; the messages recorded so far are kept", err=True)
    return INTERRUPTED if request.interrupted else FAILED


def _compile(folder: RunFolder, request: StopRequest) -> int | None:
    """Compile all kernels in another process, which a signal can end at once. Return an exit code if that fails."""
    from services.reporting.terminal import progress_bar
    from services.runtime.stopping import DONE, FAILED, INTERRUPTED
    from services.supervisor import jit_cache
    from services.supervisor.child import describe_exit

    if jit_cache.is_warm():
        return None
    typer.echo(jit_cache.NOTE, err=True)
    try:
        with progress_bar("compiling") as show:

            def wait(share: float) -> None:
                show(share)
                if request.wait(jit_cache.POLL_S):
                    raise InterruptedError

            log = folder.path / "compiling.log"
            code = jit_cache.fill(folder.scenario, log, wait)
    except InterruptedError:
        typer.echo("stopped while compiling", err=True)
        return INTERRUPTED if request.interrupted else FAILED
    if code != DONE:
        typer.echo(f"compiling {describe_exit(code)}: see {log}", err=True)
        return FAILED
    log.unlink()
    return None


def _run_processes(
    run_config: RunConfig, folder: RunFolder, as_json: bool, certs: Path | None, *, page: bool, open_browser: bool
) -> int:
    from services.dashboard.config import About, Config
    from services.dashboard.sidecar import Sidecar
    from services.reporting.plots.collector import Collector
    from services.reporting.terminal import RunScreen
    from services.run.folder import REPORT
    from services.supervisor.supervisor import Supervisor

    collector = Collector(run_config.vehicle)
    collector.set_files(run_config.files)
    screen = RunScreen(run_config.scenario.title, collector)
    about = About(
        name=f"{run_config.scenario.title} · vehicle {run_config.vehicle.name}",
        report=str(folder.path / REPORT),
        again=_again(folder.path, folder),
    )
    config = Config(vehicle=str(folder.config("vehicle")), about=about, open_browser=open_browser, of_a_run=True)
    sidecar = Sidecar(screen.say, folder.path / "logs", config, waits=not as_json)
    try:
        outcome = Supervisor(run_config, folder, screen, sidecar if page else None).run(certs)
        if outcome.summary is None:
            typer.echo(str(folder.path), err=True)
        else:
            _print_summary(outcome.summary, folder, as_json)
            sidecar.give_report()
    finally:
        sidecar.stop()
    return outcome.exit_code


def _print_summary(summary: Summary, folder: RunFolder, as_json: bool) -> None:
    """Write the report, then print summary.json or a few lines with the folder of the run on stdout."""
    import msgspec

    from services.cli.runs import after_run
    from services.reporting.run_summary_text import verdict

    plain = msgspec.to_builtins(summary)
    typer.echo(after_run(folder.recording, plain), err=True)
    show(summary, lambda: verdict(plain, folder.path, _next_commands(plain, folder)), as_json=as_json)


def _next_commands(summary: Mapping[str, Any], folder: RunFolder) -> list[str]:
    """Return commands for the same scenario: the other mode, the verdict's proposal, a replay."""
    from services.reporting.assessment import next_option
    from services.run.folder import LATEST

    path = folder.path
    if (latest := path.parent / LATEST).exists() and latest.samefile(path):
        path = latest
    again = _again(path, folder)
    other_mode = again if summary["mode"] == "lockstep" else f"{again} --lockstep"
    option = next_option(summary)
    proposal = [f"{again} {option}"] if option else []
    return [other_mode, *proposal, f"{_program()} replay {shlex.quote(str(path))}"]


def _again(path: Path, folder: RunFolder) -> str:
    """Return the command that runs the scenario in the run's folder ``path`` again."""
    return f"{_program()} sim {shlex.quote(str(path / folder.scenario.name))}"


def _program() -> str:
    return "ltv-mpc" if shutil.which("ltv-mpc") else ".venv/bin/ltv-mpc"


@with_bus("operator")
def dashboard(
    port: Annotated[int, option("P", "TCP port of the page; 0 takes any free one.", min=0, max=65535)] = 0,
    host: Annotated[
        str, option("ADDRESS", "Address of this machine; any but loopback opens the page to others.")
    ] = "127.0.0.1",
    open_: Annotated[bool, flag("--open", "Open the page in a browser.")] = False,
    vehicle: ShownVehicle = None,
    *,
    bus: BusOptions,
) -> int:
    """Watch any run, or your own vehicle, in a browser.

    Prints the address of the page with the token for its buttons; without the token the page is read-only.
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        raise invalid("option --host", "must be an IP address such as 127.0.0.1", value=host) from None
    if address.is_unspecified:
        problem = "must be one address, not all of them: the page checks it in each request"
        raise invalid("option --host", problem, value=host)
    from services.dashboard.config import Config, missing_package

    if missing := missing_package():
        typer.echo(f"dashboard: {missing}", err=True)
        return 1
    from services.dashboard import serve

    return serve.main(Config(bus=bus, host=host, port=port, vehicle=vehicle, open_browser=open_))


@with_bus("display")
def watch(vehicle: ShownVehicle = None, *, bus: BusOptions) -> int:
    """Watch any run, or your own vehicle, in the terminal.

    Fits 80 x 24 characters, so that it works over ssh. It only reads. In a pipe it prints a line every 5 s.
    """
    from services.tools import watch as screen

    return screen.main(bus, vehicle)


INDENT = 25
"""Columns before what was found: severity and check."""


def doctor(as_json: Json = False) -> int:
    """Check this machine and print a remedy for each problem.

    Exit code 1 if there is a problem; a warning is not a problem.
    """
    from services.tools.doctor import Level, examine

    found = examine()
    lines = []
    for finding in found:
        lines.append(fold(f"{finding.level:<8} {finding.check:<15} {finding.found}", indent=INDENT))
        if finding.remedy:
            lines.append(fold(f"{'':<{INDENT}}-> {finding.remedy}", indent=INDENT + 3))
    lines += ["", "`ltv-mpc completion --install` adds completion of commands and options."]
    counts = {level.value: sum(finding.level is level for finding in found) for level in Level}
    show({"findings": found, "counts": counts}, lambda: "\n".join(lines), as_json=as_json)
    return int(any(finding.level is Level.PROBLEM for finding in found))


def completion(
    context: typer.Context, install: Annotated[bool, flag("--install", "Add it to the shell's start-up file.")] = False
) -> None:
    """Print or install the completion script of your shell.

    The shell is the one that runs the command: bash, zsh, fish or PowerShell.
    """
    option = "--install-completion" if install else "--show-completion"
    context.find_root().command.main([option], prog_name="ltv-mpc")
