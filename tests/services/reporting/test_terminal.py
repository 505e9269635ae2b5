"""The live screen fits 80 x 24 characters and shows the content of the messages."""

from __future__ import annotations

import dataclasses
import io
import math
from collections.abc import Sequence

import msgspec
import numpy as np
import pytest
from rich.console import Console

from ltv_mpc.messages import (
    Applied,
    Authority,
    ControllerStatus,
    CurrentProfile,
    CycleTiming,
    Estimate,
    FilterStatus,
    Health,
    LocalisationReport,
    NodeStatus,
    Plan,
    PlanOrigin,
    SensorReport,
    SensorStatus,
    Solve,
    SolveStatus,
    Truth,
)
from services.reporting.terminal import RunScreen, bar, is_plain
from services.supervisor.screen import ORDER, LiveView
from tests.services.bus.messages import EXAMPLES
from tests.services.words import status

LIMITS = [(-62.5, 62.5)] * 3
S = 1_000_000_000

TRUTH = Truth(
    t_ns=123 * S,
    position_m=(3.0, 4.0, 1234.5),
    velocity_mps=(0.0, 0.0, 0.2),
    attitude_rad=(0.0, 0.0, -math.pi / 2),
    water_velocity_mps=(0.0, 0.0, 0.2),
    yaw_rate_radps=0.0,
    current_mps=(0.03, 0.04),
    thrust_N=(-62.5, 31.25, 62.5),
)
APPLIED = Applied(
    t_ns=123 * S,
    thrust_N=(-62.5, 31.25, 62.5),
    command_N=(-62.5, 31.25, 62.5),
    command_slew_N_per_s=(0.0, 0.0, 0.0),
    plan_epoch=1,
    plan_sequence=2,
    plan_cycle_t_ns=122 * S,
    plan_received_t_ns=122 * S,
    plan_late=False,
    plans_late=123456,
    plans_rejected=0,
)
PLAN = Plan(
    cycle_t_ns=122 * S,
    t_ns=np.array([122 * S, 123 * S]),
    thrust_N=np.zeros((2, 3)),
    states=np.zeros((2, 6)),
    origin=PlanOrigin.SHIFTED,
    solve=Solve(status=SolveStatus.SOLVED),
    reference_m=(0.0, 0.0),
)
TIMING = CycleTiming(
    t_ns=122 * S,
    compute_ns=5_000_000,
    compute_wall_ns=1_234_500_000,
    estimate_age_ns=0,
    stage_us={"predict": 1e3, "linearise": 3e5, "build": 2e5, "update": 1e5, "solve": 1.23456e6, "read": 1.0},
)


def long_status(node: str) -> NodeStatus:
    waiting_for = "sensors, estimator, controller, recorder to be ready" if node == "plant" else ""
    counts = dict.fromkeys(("steps", "published", "received"), 99_999_999)
    lost = dict.fromkeys(("dropped", "rejected"), 9_999_999)
    return status(node, waiting_for=waiting_for, step_us=123456.0, **counts, **lost)


ESTIMATE = msgspec.structs.replace(
    Estimate.at_rest(north_m=2.7, east_m=3.6, heading_rad=-math.pi / 2, depth_m=1234.5),
    t_ns=122_750_000_000,
    current=CurrentProfile(depth_m=np.array([1.0]), north_mps=np.array([0.03]), east_mps=np.array([0.04])),
)
CONTROLLER = msgspec.structs.replace(
    next(message for message in EXAMPLES if isinstance(message, ControllerStatus)),
    authority=Authority.CONTROLLER,
    health=Health.DEGRADED,
    health_why="the estimates are too old",
    error_m=0.021,
    progress=0.62,
)
LOCALISATION = LocalisationReport(
    t_ns=123 * S,
    status=FilterStatus.INCONSISTENT,
    why="adcp: more than half of its measurements fail the gate",
    restarts=0,
    water_walk_mps_per_rts=0.0,
    sensors=tuple(
        SensorReport(sensor=name, status=status, used=0, rejected={}, nis=None, last_t_ns=None)
        for name, status in (("adcp", SensorStatus.REJECTED), ("gnss", SensorStatus.OK), ("lbl", SensorStatus.SILENT))
    ),
)
FULL = LiveView(
    t_ns=123 * S,
    start_ns=-1 * S,
    end_ns=1800 * S,
    speed=123.4,
    requested_speed=1000.0,
    wall_s=99999.0,
    phase="diving",
    truth=TRUTH,
    estimate=ESTIMATE,
    localisation=LOCALISATION,
    plan=PLAN,
    applied=APPLIED,
    controller=CONTROLLER,
    timing=TIMING,
    status={name: long_status(name) for name in ORDER},
    state=dict.fromkeys(ORDER, "running"),
)
EMPTY = LiveView(t_ns=0, start_ns=-S, end_ns=200 * S, speed=10.0, wall_s=0.0, requested_speed=10.0, phase="starting")


def drawn(view: LiveView, limits: Sequence[tuple[float, float]] = LIMITS) -> list[str]:
    console = Console(width=80, height=24, file=io.StringIO())
    screen = RunScreen("a title that is much longer than a line of a terminal " * 3, limits, console)
    screen.update(view)
    screen.close()
    with console.capture() as capture:
        console.print(screen.render(view))
    return capture.get().splitlines()


def test_beside_a_boat_the_screen_has_what_a_boat_has() -> None:
    boat = dataclasses.replace(
        FULL,
        end_ns=None,
        truth=None,
        localisation=None,
        estimate=msgspec.structs.replace(FULL.estimate, depth_m=None, current=None),
    )
    text = "\n".join(drawn(boat, []))
    assert "port" in text
    assert "starboard" in text
    for of_a_dive in ("vertical", "depth", "filter", "current"):
        assert of_a_dive not in text


@pytest.mark.parametrize("view", [FULL, EMPTY], ids=["full", "empty"])
def test_the_screen_fits_80_by_24(view: LiveView) -> None:
    lines = drawn(view)
    assert len(lines) <= 24
    assert max(len(text) for text in lines) <= 80


def test_the_screen_says_what_the_messages_hold() -> None:
    text = "\n".join(drawn(FULL))
    assert "1234.50 m" in text  # depth
    assert "estimate from the reference 4.500 m" in text
    assert "vehicle 4.500 m since t = 122.8 s" in text  # of the estimate, since it is the first that was received
    assert "control controller   degraded (the estimates are too old)   progress 62 %" in text
    assert "arrived" not in text
    arrived = dataclasses.replace(FULL, controller=msgspec.structs.replace(FULL.controller, arrived=True))
    assert "(the estimates are too old)   arrived" in "\n".join(drawn(arrived))
    assert "270 deg" in text
    assert "0.050 m/s" in text
    assert "estimate 0.25 s" in text
    assert "plan 1.00 s (shifted)" in text
    assert "late plans 123456" in text
    assert "diving  wall time 99999 s" in text
    for name in (*ORDER, "port", "starboard", "vertical", "solve"):
        assert name in text


def test_a_vehicle_without_truth_and_known_limits_has_no_bars_and_no_end() -> None:
    lines = drawn(dataclasses.replace(FULL, truth=None, end_ns=None, phase=""), limits=())
    assert lines[1].strip() == "t    123.0 s"
    assert not any("vehicle from the reference" in line or "|" in line for line in lines)
    assert any(line.split() == ["starboard", "31.2", "N"] for line in lines)


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
    assert bar(0.0, -62.5, 62.5, width=9) == "|    +    |"
    assert bar(-1.0, 0.0, 62.5, width=9) == "|    +    |"  # a thruster that cannot push astern
    assert len({len(bar(x, -10.0, 62.5)) for x in (-99.0, -5.0, 0.0, 1.0, 99.0)}) == 1


def test_where_nobody_looks_there_are_plain_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.delenv("CI", raising=False)
    terminal = Console(file=io.StringIO(), force_terminal=True)
    assert is_plain(Console(file=io.StringIO()))
    assert not is_plain(terminal)
    for variable in ("NO_COLOR", "CI"):
        with monkeypatch.context() as patch:
            patch.setenv(variable, "1")
            assert is_plain(terminal)


def test_a_plain_line_is_one_line_without_control_characters() -> None:
    file = io.StringIO()
    screen = RunScreen("x", LIMITS, Console(file=file, width=80))
    screen.update(FULL)
    screen.update(FULL)  # too soon for another
    screen.say("[bold]a phase")
    screen.close()
    first, second = file.getvalue().splitlines()
    assert "depth 1234.5 m" in first
    assert first.isprintable()
    assert "plant waits for sensors" in first
    assert second == "[bold]a phase"
