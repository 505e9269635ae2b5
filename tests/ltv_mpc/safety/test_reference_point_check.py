"""Reference point check: estimates of a point that was not declared are named, others are not."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc import Vehicle
from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.disturbance import CurrentBias
from ltv_mpc.control.nominal_model import as_estimate
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.messages import CurrentProfile, Estimate, Plan, PlanOrigin, Solve, SolveStatus
from ltv_mpc.safety.reference_point_check import ReferencePointCheck
from ltv_mpc.vehicle.reference_point import ORIGIN, ReferencePoint

PAPER = Vehicle.load("paper")
PERIOD_NS = 300_000_000
CURRENT = CurrentProfile(depth_m=np.zeros(1), north_mps=np.array([0.1]), east_mps=np.array([-0.05]))


def checked(
    offset: ReferencePoint, *, cycles: int = 150, turn_N: float = 30.0, noise_mps: float = 0.0
) -> ReferencePointCheck:
    """Return the check after a motion that turns to and fro, seen at a point ``offset`` from the origin."""
    rng, check = np.random.default_rng(0), ReferencePointCheck()
    commands, model, bias = SentCommands(PAPER), Prediction(PAPER), CurrentBias(Disturbance())
    estimate = msgspec.structs.replace(Estimate.at_rest(depth_m=5.0), current=CURRENT)
    back = msgspec.structs.replace(offset, forward_m=-offset.forward_m, starboard_m=-offset.starboard_m)
    for k in range(cycles):
        side = turn_N * np.sin(0.7 * k * PERIOD_NS * 1e-9)
        thrust = np.array([[20.0 + side, 20.0 - side, 0.0]] * 2)
        t_ns = estimate.t_ns + np.array([0, 10 * PERIOD_NS])
        commands.add(
            Plan(
                cycle_t_ns=estimate.t_ns,
                t_ns=t_ns,
                thrust_N=thrust,
                states=np.zeros((2, 6)),
                origin=PlanOrigin.SOLVED,
                solve=Solve(status=SolveStatus.SOLVED),
            )
        )
        seen, (north, east) = back.to_origin(estimate), rng.normal(0.0, noise_mps, 2)
        seen = msgspec.structs.replace(
            seen,
            velocity_north_mps=seen.velocity_north_mps + north,
            velocity_east_mps=seen.velocity_east_mps + east,
        )
        check.update(*bias.correct(seen, model, commands))
        estimate = as_estimate(model.state_at(estimate, estimate.t_ns + PERIOD_NS, commands), estimate)
    return check


@pytest.mark.parametrize(
    ("offset", "named"),
    [
        (ReferencePoint(forward_m=0.5), "0.5 m ahead and 0.0 m"),
        (ReferencePoint(forward_m=-0.5), "0.5 m astern and 0.0 m"),
        (ReferencePoint(starboard_m=0.5), "0.5 m to starboard"),
        (ReferencePoint(forward_m=0.3, starboard_m=-0.4), "0.3 m ahead and 0.4 m to port"),
    ],
)
@pytest.mark.parametrize("noise_mps", [0.0, 0.002])
def test_an_undeclared_point_is_named(offset: ReferencePoint, named: str, noise_mps: float) -> None:
    check = checked(offset, noise_mps=noise_mps)
    assert check.health.health == "degraded"
    assert named in check.why
    assert check.health.why in check.why


@pytest.mark.parametrize("noise_mps", [0.0, 0.01, 0.05])
def test_estimates_of_the_declared_point_are_not(noise_mps: float) -> None:
    assert checked(ORIGIN, noise_mps=noise_mps).health.health == "nominal"


def test_a_straight_course_tells_nothing() -> None:
    assert checked(ReferencePoint(forward_m=0.5), turn_N=0.0, noise_mps=0.01).health.health == "nominal"


def test_it_takes_more_than_the_first_turn() -> None:
    assert checked(ReferencePoint(forward_m=0.5), cycles=30).health.health == "nominal"


def test_a_thruster_that_follows_its_command_late_is_no_lever_arm() -> None:
    """The vehicle starts with full thrust and turns a little: the model predicts a tenth more speed than it gets."""
    check, rest = ReferencePointCheck(), Estimate.at_rest()
    check.update(rest, None)
    first = msgspec.structs.replace(rest, t_ns=PERIOD_NS, velocity_north_mps=0.5, yaw_rate_radps=-0.015)
    check.update(first, (0.55, 0.0))
    for k in range(2, 100):
        later = msgspec.structs.replace(first, t_ns=k * PERIOD_NS, yaw_rate_radps=0.0005 * (-1) ** k)
        check.update(later, (0.5, 0.0))
    assert check.health.health == "nominal"
