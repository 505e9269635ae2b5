"""The screen of a run fits 80 x 24 characters and shows the content of the messages; a pipe gets lines."""

from __future__ import annotations

import dataclasses
import io
import math

import pytest
from msgspec.structs import replace
from rich.console import Console

from ltv_mpc.messages import Authority, FilterStatus, Health, NodeStatus, PlanOrigin, SensorStatus
from ltv_mpc.vehicle.parameters import Vehicle
from services.reporting.plots.collector import Collector
from services.reporting.terminal import RunScreen, bar, is_plain, observe, progress_bar
from services.supervisor.screen import ORDER, LiveView
from tests.services import controller_status
from tests.services.reporting import synthetic_run
from tests.services.reporting.synthetic_run import S
from tests.services.words import status

PAPER = Vehicle.load("paper")
NOW_NS = 21 * S
SPENT_US = {"predict": 1e3, "linearise": 3e5, "build": 2e5, "update": 1e5, "solve": 1.23456e6, "read": 1.0}


def long_status(node: str) -> NodeStatus:
    waiting_for = "sensors, estimator, controller, recorder to be ready" if node == "plant" else ""
    counts = dict.fromkeys(("steps", "published", "received"), 99_999_999)
    lost = dict.fromkeys(("dropped", "rejected"), 9_999_999)
    return status(node, waiting_for=waiting_for, step_us=123456.0, **counts, **lost)


CONTROLLER = replace(
    controller_status.status(),
    **{"authority": Authority.CONTROLLER, "health": Health.DEGRADED, "progress": 0.62},
    health_why="the estimates are too old",
)
REPORT = synthetic_run.report(NOW_NS)
STATUSES = zip(REPORT.sensors, (SensorStatus.REJECTED, SensorStatus.OK, SensorStatus.SILENT), strict=False)
LOCALISATION = replace(
    REPORT,
    status=FilterStatus.INCONSISTENT,
    why="adcp: more than half of its measurements fail the gate",
    sensors=tuple(replace(sensor, status=state) for sensor, state in STATUSES),
)
EMPTY = LiveView(t_ns=0, start_ns=-S, end_ns=200 * S, speed=10.0, wall_s=0.0, requested_speed=10.0, phase="starting")
FULL = dataclasses.replace(
    EMPTY,
    **{"t_ns": NOW_NS, "end_ns": 1800 * S, "speed": 123.4, "requested_speed": 1000.0, "wall_s": 99999.0},
    phase="diving",
    truth=synthetic_run.truth(NOW_NS),
    estimate=replace(synthetic_run.estimate(NOW_NS - S // 4), heading_rad=-math.pi / 2, depth_m=1234.5),
    localisation=LOCALISATION,
    plan=synthetic_run.plan(NOW_NS - S, origin=PlanOrigin.SHIFTED),
    applied=replace(synthetic_run.applied(NOW_NS), thrust_N=(-62.5, 31.25, 62.5), plans_late=123456),
    controller=CONTROLLER,
    timing=replace(synthetic_run.timing(NOW_NS, wall_ms=1234.5), stage_us=SPENT_US),
    status={name: long_status(name) for name in ORDER},
    state=dict.fromkeys(ORDER, "running"),
)


def drawn(view: LiveView, vehicle: Vehicle | None = PAPER) -> list[str]:
    console = Console(width=80, height=24, file=io.StringIO())
    screen = RunScreen("a title that is much longer than a line of a terminal " * 3, vehicle, console)
    screen.update(view)
    screen.close()
    with console.capture() as capture:
        console.print(screen.render(view))
    return capture.get().splitlines()


@pytest.mark.parametrize("view", [FULL, EMPTY], ids=["full", "empty"])
def test_the_screen_fits_80_by_24(view: LiveView) -> None:
    lines = drawn(view)
    assert len(lines) <= 24
    assert max(len(text) for text in lines) <= 80


def test_the_screen_says_what_the_messages_hold() -> None:
    text = "\n".join(drawn(FULL))
    estimate_m, vehicle_m = (math.hypot(3.0 + north - 1.0, -4.0 + 0.2075 - 2.0) for north in (2.075, 2.1))
    for words in (
        *("depth 1234.50 m   heading 270 deg   speed 0.100 m/s   current 0.022 m/s", "plan 1.00 s (shifted)"),
        f"estimate from the reference {estimate_m:.3f} m   vehicle {vehicle_m:.3f} m since t = 20.8 s",  # joined late
        *("control controller   degraded   progress 62 %", "why     the estimates are too old"),
        *("estimate 0.25 s", "late plans 123456", "diving  wall time 99999 s", "123 of 1000x", *ORDER),
        *("inconsistent (adcp: more than half", "cycle   1234.5 ms, most of it:  solve 1234.56"),
        f"port         -62.5 N  {bar(-62.5, -62.5, 62.5)}",
    ):
        assert words in text
    assert "arrived" not in text
    arrived = dataclasses.replace(FULL, controller=replace(CONTROLLER, arrived=True))
    assert "control controller   degraded   arrived" in "\n".join(drawn(arrived))


def test_a_reason_to_stand_still_fits_a_line_with_the_time_since_it_came() -> None:
    why = "not driving: autopilot in failsafe; end its cause and set MANUAL"
    plans = [replace(FULL.plan, health=Health.DEGRADED, health_why=why, cycle_t_ns=t * S) for t in (20, 40, 61)]
    screen = RunScreen("a boat", PAPER, console := Console(width=80, height=24, file=io.StringIO()))
    for plan in plans:
        screen.update(dataclasses.replace(FULL, t_ns=plan.cycle_t_ns, plan=plan))
    with console.capture() as capture:
        console.print(
            screen.render(dataclasses.replace(FULL, t_ns=61 * S, controller=replace(CONTROLLER, health_why=why)))
        )
    assert f"why     {why}, 41 s" in capture.get()


def test_the_title_is_bold_and_a_thruster_at_its_limit_is_yellow() -> None:
    out = io.StringIO()
    console = Console(file=out, width=80, height=24, force_terminal=True, color_system="standard")
    console.print(RunScreen("a run", PAPER, console).render(FULL))
    lines = out.getvalue().splitlines()
    assert any("\x1b[1m" in line and "a run" in line for line in lines)
    yellow = {name: any(f"\x1b[33m{name}" in line for line in lines) for name in ("port", "starboard", "vertical")}
    assert yellow == {"port": True, "starboard": False, "vertical": True}


def test_beside_a_boat_the_screen_has_what_a_boat_has() -> None:
    afloat = replace(synthetic_run.estimate(NOW_NS), depth_m=None, current=None)
    boat = dataclasses.replace(FULL, end_ns=None, truth=None, localisation=None, estimate=afloat, phase="")
    lines = drawn(boat, None)
    text = "\n".join(lines)
    assert lines[1].strip() == "t     21.0 s"
    assert any(line.split() == ["starboard", "31.2", "N"] for line in lines)
    for of_a_dive in ("vertical", "depth", "filter", "current", "vehicle", "|"):
        assert of_a_dive not in text


def test_without_a_message_nothing_looks_like_a_measurement() -> None:
    lines = drawn(dataclasses.replace(EMPTY, end_ns=None, phase="no message yet"))
    assert lines[1].split() == ["t", "-", "no", "message", "yet"]
    assert [line.split() for line in lines if line.endswith(" N")] == [
        [name, "-", "N"] for name in ("port", "starboard", "vertical")
    ]


def test_a_bar_is_full_at_the_limit_and_points_where_the_thrust_goes() -> None:
    assert bar(62.5, -62.5, 62.5, width=9) == "|    +====|"
    assert bar(-31.25, -62.5, 62.5, width=9) == "|  ==+    |"
    assert bar(-5.0, -10.0, 62.5, width=9) == "|  ==+    |"  # of what it can push astern
    assert bar(-1.0, 0.0, 62.5, width=9) == "|    +    |"  # a thruster that cannot push astern
    assert len({len(bar(x, -10.0, 62.5)) for x in (-99.0, -5.0, 0.0, 1.0, 99.0)}) == 1


def test_a_pipe_gets_lines_without_control_characters(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.delenv("CI", raising=False)
    terminal, file = Console(file=io.StringIO(), force_terminal=True), io.StringIO()
    assert not is_plain(terminal)
    for variable in ("NO_COLOR", "CI"):
        with monkeypatch.context() as patch:
            patch.setenv(variable, "1")
            assert is_plain(terminal)
    screen = RunScreen("x", PAPER, Console(file=file, width=80))
    screen.update(FULL)
    screen.update(FULL)  # too soon for another
    screen.say("[bold]a phase")
    screen.close()
    first, second = file.getvalue().splitlines()
    assert "depth 1234.50 m" in first
    assert "cycle 1234.5 ms" in first
    assert first.isprintable()
    assert "plant waits for sensors" in first
    assert second == "[bold]a phase"


def shown(errors: Collector, t_ns: int, *, north_m: float, age_ns: int = 0) -> float | None:
    """Show the made-up dive at a time, ``north_m`` off the estimate; return the distance of the vehicle."""
    estimate = synthetic_run.estimate(t_ns - age_ns)
    estimate = replace(estimate, north_m=estimate.north_m + north_m)
    plan = synthetic_run.plan(t_ns, target=(3.0, -4.0))
    observe(
        errors, dataclasses.replace(EMPTY, t_ns=t_ns, truth=synthetic_run.truth(t_ns), estimate=estimate, plan=plan)
    )
    return errors.true_error_m


@pytest.mark.parametrize("age_ns", [0, S // 5])
def test_the_error_of_the_first_fix_is_no_drift_also_of_an_old_estimate(age_ns: int) -> None:
    """The vehicle begins 3 m from its estimate and moves 0.1 m a second; an estimate is compared with its own time."""
    errors = Collector()
    shown(errors, S, north_m=0.0, age_ns=age_ns)
    assert shown(errors, 3 * S, north_m=0.5) == pytest.approx(0.3, abs=1e-3)


def test_an_estimate_from_before_the_start_does_not_say_where_the_reference_is() -> None:
    """At ten times real time the first view after the start may hold an estimate from before a fix, metres off."""
    errors = Collector()
    assert shown(errors, S // 2, north_m=2.0, age_ns=S // 2 + 1) is None
    assert shown(errors, S, north_m=0.0) == pytest.approx(0.1, abs=1e-3)


def test_without_a_terminal_progress_is_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, out = [0.0], io.StringIO()
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    with progress_bar("a campaign", Console(file=out, width=80), line_s=10.0) as show:
        for share in (0.1, 0.2, 0.5, 0.6):
            now_s[0] += 6.0
            show(share)
    assert out.getvalue().splitlines() == ["a campaign: 20%", "a campaign: 60%"]
