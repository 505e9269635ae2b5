"""Logs of real use: which pieces have a known thrust, and one line for a log to which no vehicle can be fitted."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from ltv_mpc import Vehicle
from ltv_mpc.messages import Applied, Authority, Estimate, Message, Plan
from services.cli.app import run
from services.tools.vehicle_identify import motion_of
from tests.ltv_mpc.plans import plan_of
from tests.ltv_mpc.reports import report
from tests.services.recording.recordings import write

PAPER = Vehicle.load("paper")
PERIOD_NS = 100_000_000


def estimate(k: int, speed_mps: float = 0.0, turn_radps: float = 0.0) -> Estimate:
    return Estimate(
        t_ns=k * PERIOD_NS,
        north_m=0.0,
        east_m=0.0,
        heading_rad=math.remainder(0.1 * k * turn_radps, 2.0 * math.pi),
        yaw_rate_radps=turn_radps,
        velocity_north_mps=speed_mps,
        velocity_east_mps=0.0,
    )


def applied(k: int, thrust_N: float, command_N: float | None = None) -> Applied:
    command = thrust_N if command_N is None else command_N
    return report(k * PERIOD_NS, (thrust_N, thrust_N, 0.0), (command, command, 0.0), plan_epoch=1, plan_sequence=k)


def planned(k: int, thrust_N: float, authority: Authority = Authority.CONTROLLER) -> tuple[int, Plan]:
    t_ns = k * PERIOD_NS
    return t_ns, plan_of(t_ns, [(thrust_N, thrust_N, 0.0)] * 2, 3_000_000_000, authority=authority)


COUNT = 400
ESTIMATES = [estimate(k) for k in range(COUNT)]


def used(reports: list[Applied], plans: list[tuple[int, Plan]]) -> set[int]:
    """Return the numbers of the estimates that are used; each log begins with a usable one."""
    return set(np.rint(motion_of(PAPER, ESTIMATES, reports, plans).t_s * 1e9 / PERIOD_NS).astype(int).tolist())


def test_estimates_between_reports_that_are_far_apart_are_left_out() -> None:
    reports = [applied(k, 10.0) for k in range(COUNT) if not 100 < k < 200]
    assert used(reports, []) == set(range(COUNT)) - set(range(101, 200))


@pytest.mark.parametrize(
    ("plan_N", "authority", "kept"),
    [
        (20.0, Authority.CONTROLLER, False),  # the plan is not followed: someone else steers
        (0.0, Authority.CONTROLLER, True),  # a stop
        (0.0, Authority.MANUAL, True),
        (0.0, Authority.DISARMED, False),
        (0.0, Authority.STOPPED, False),
    ],
)
def test_pieces_with_released_thrusters_are_left_out(plan_N: float, authority: Authority, kept: bool) -> None:
    idle = range(100, 200)
    reports = [applied(k, 0.0 if k in idle else 15.0) for k in range(COUNT)]
    plans = [
        planned(k, plan_N if k in idle else 15.0, authority if k in idle else Authority.CONTROLLER)
        for k in range(COUNT)
    ]
    assert used(reports, plans) == (set(range(COUNT)) if kept else set(range(COUNT)) - set(idle))


@pytest.mark.parametrize(("idle", "kept"), [(range(100, 150), True), (range(100, 200), False)])
def test_without_plans_a_long_rest_of_the_thrusters_is_left_out_and_a_stop_is_not(idle: range, kept: bool) -> None:
    reports = [applied(k, 0.0 if k in idle else 15.0) for k in range(COUNT)]
    assert used(reports, []) == (set(range(COUNT)) if kept else set(range(COUNT)) - set(idle))


def test_a_plan_that_is_not_followed_for_3_s_is_left_out_and_a_late_start_is_not() -> None:
    late, released = range(50, 58), range(100, 130)
    reports = [applied(k, 0.0 if k in late or k in released else 15.0) for k in range(COUNT)]
    assert used(reports, [planned(k, 15.0) for k in range(COUNT)]) == set(range(COUNT)) - set(released)


def test_thrusts_of_a_pilot_are_used_as_reported_while_the_controller_is_disarmed() -> None:
    reports = [applied(k, 15.0) for k in range(COUNT)]
    assert used(reports, [planned(k, 0.0, Authority.DISARMED) for k in range(COUNT)]) == set(range(COUNT))


def test_without_reports_only_plans_in_force_are_used() -> None:
    """They last for 3 s; from 20 s on the controller is disarmed."""
    plans = [planned(k, 15.0, Authority.CONTROLLER if k < 200 else Authority.DISARMED) for k in range(0, COUNT, 50)]
    assert used([], plans) == {k + i for k in range(0, 200, 50) for i in range(31)}


def record(path: Path, messages: Iterable[Message | tuple[int, Plan]], segment: str = "run.mcap") -> str:
    path.mkdir(exist_ok=True)
    timed = (message if isinstance(message, tuple) else (message.t_ns, message) for message in messages)
    write(path / segment, (("estimator", message, 1, i, t_ns) for i, (t_ns, message) in enumerate(timed)), start_ns=0)
    return str(path)


def both(count: int, speed_mps: float, thrust_N: float, turn_radps: float = 0.0) -> list[Message]:
    return [message for k in range(count) for message in (estimate(k, speed_mps, turn_radps), applied(k, thrust_N))]


@pytest.mark.parametrize(
    ("messages", "says"),
    [
        ([], "0 of 0 estimates have a known thrust"),
        (ESTIMATES, "0 of 400 estimates have a known thrust"),
        ([estimate(0)], "0 of 1 estimates"),
        (both(50, 0.3, 10.0), "1 segments of 6 s: at least 5 are needed"),
        (both(COUNT, 0.0, 10.0), "velocity and yaw rate are constant"),
        (both(COUNT, 0.3, 0.0), "0 of 400 estimates have a known thrust"),
        ([*both(COUNT, 0.0, 10.0), *both(COUNT, 0.0, 10.0)], "velocity and yaw rate are constant"),  # each stamp twice
        (both(COUNT, 45.0, 10.0, 3.0), "cannot be fitted: the predicted motion diverges"),
    ],
    ids=["empty", "no thrust", "one estimate", "short", "at rest", "no thrust reported", "doubled", "on a train"],
)
def test_a_log_to_which_nothing_can_be_fitted_is_one_line_and_exit_code_2(messages, says, tmp_path, capsys) -> None:
    assert run(["vehicle", "identify", record(tmp_path / "log", messages), "--vehicle", "paper"]) == 2
    error = capsys.readouterr().err
    assert "run.mcap" in error
    assert says in error
    assert error.strip().count("\n") == 0


def test_all_segments_of_a_recording_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first alone is too short for a fit."""
    messages = both(COUNT, 0.0, 10.0)
    record(tmp_path / "log", messages[:40])
    log = record(tmp_path / "log", messages[40:], "run.2.mcap")
    assert run(["vehicle", "identify", log, "--vehicle", "paper"]) == 2
    assert "velocity and yaw rate are constant" in capsys.readouterr().err
