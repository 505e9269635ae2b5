"""Estimate gate: bounds by vehicle, and jumps."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.messages import Estimate
from ltv_mpc.safety.estimate_gate import JUMPED, Bounds, EstimateGate
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.resistance import steady_speed

PAPER = Vehicle.load("paper")
HERE = Estimate.at_rest(north_m=1.0, east_m=2.0, heading_rad=0.5, depth_m=5.0)
PERIOD_NS = 100_000_000


def at(k: int, base: Estimate = HERE, **changes: object) -> Estimate:
    return msgspec.structs.replace(base, t_ns=k * PERIOD_NS, **changes)


def settled(**changes: object) -> EstimateGate:
    gate = EstimateGate(PAPER)
    assert gate.check(at(0, **changes)) == ""
    return gate


def test_bounds_are_those_of_the_paper_s_vehicle_by_hand():
    """sqrt(125 / 500) = 0.5 m/s; 25 N m = 15 r + 200 r^2: r = 0.318; sqrt(93 / 800) = 0.341 m/s."""
    bounds = Bounds.of(PAPER)
    assert bounds.speed_mps == pytest.approx(2 * 0.5 + 3.0)
    assert bounds.yaw_rate_radps == pytest.approx(3 * 0.31803 + 0.5, abs=1e-4)
    assert bounds.sinking_mps == pytest.approx(2 * math.sqrt(93 / 800) + 1.0)


@given(st.floats(0, 1e3), st.floats(0, 1e3), st.floats(1e-3, 1e3))
def test_at_the_steady_speed_damping_balances_the_force(force, linear, quadratic):
    v = steady_speed(force, linear, quadratic)
    assert linear * v + quadratic * v * v == pytest.approx(force, rel=1e-6, abs=1e-6)
    assert steady_speed(force, max(linear, 1e-3), 0.0) == force / max(linear, 1e-3)
    assert steady_speed(force, 0.0, 0.0) == math.inf


@pytest.mark.parametrize(
    "field",
    ["north_m", "east_m", "heading_rad", "velocity_north_mps", "velocity_east_mps", "yaw_rate_radps", "depth_m"],
)
def test_a_non_finite_estimate_is_rejected_and_counted_and_the_last_one_stays(field):
    gate = settled()
    before = gate.accepted
    assert gate.check(at(1, **{field: math.nan})) == "a number is not finite"
    assert gate.accepted is before
    assert gate.rejected == {"a number is not finite": 1}
    assert gate.check(at(2)) == ""


def test_the_health_says_why_no_estimate_is_accepted_until_one_is():
    gate = settled()
    for k in range(1, 20):
        gate.check(at(k, yaw_rate_radps=20.0))
    assert "yaw rate above what the vehicle can reach" in gate.health(20 * PERIOD_NS).why
    assert gate.check(at(20)) == ""
    assert "rejected" not in gate.health(40 * PERIOD_NS).why


@pytest.mark.parametrize("place", [(0, 0), (3, 1)])
def test_an_estimate_with_a_covariance_that_is_not_finite_is_rejected(place):
    """A NaN variance would pass every comparison with a multiple of it."""
    covariance = np.eye(6)
    covariance[place] = math.nan
    assert settled().check(at(1, covariance=covariance)) == "a number is not finite"


@pytest.mark.parametrize(
    ("inside", "outside"),
    [
        ({"velocity_north_mps": 3.9}, {"velocity_north_mps": 4.1}),
        (
            {"velocity_north_mps": -2.8, "velocity_east_mps": 2.8},
            {"velocity_north_mps": -2.9, "velocity_east_mps": 2.9},
        ),
        ({"yaw_rate_radps": -1.4}, {"yaw_rate_radps": -1.5}),
        ({"velocity_down_mps": 1.6}, {"velocity_down_mps": 1.7}),
        ({"velocity_down_mps": None, "depth_m": None}, {"velocity_down_mps": math.nan, "depth_m": None}),
    ],
)
def test_an_estimate_out_of_the_vehicles_bounds_is_rejected(inside, outside):
    gate = EstimateGate(PAPER)
    assert gate.check(at(0, **inside)) == ""
    assert gate.check(at(1, **outside)) != ""
    assert gate.accepted.t_ns == 0


CERTAIN = {"covariance": np.diag([1e-3, 1e-3, 1e-4, 1e-4, 1e-4, 1e-6])}
DRIFTED = {"covariance": np.diag([2.0, 2.0, 1e-4, 1e-4, 0.04, 1e-6])}


@pytest.mark.parametrize(
    ("before", "after", "jump", "accepted"),
    [
        # 4 m/s x 0.1 s + 1 m are always possible
        (CERTAIN, CERTAIN, {"north_m": 2.39}, True),
        (CERTAIN, CERTAIN, {"north_m": 2.41}, False),
        # a fix after a drift of 2 m (1 sigma): 5 x (2 + 0.045) = 10.2 m
        (DRIFTED, CERTAIN, {"north_m": 11.2}, True),
        (DRIFTED, CERTAIN, {"north_m": 11.3}, False),
        # without a covariance: 5 x (5 + 5) m
        ({}, {}, {"north_m": 50.9}, True),
        ({}, {}, {"north_m": 51.1}, False),
        (CERTAIN, CERTAIN, {"heading_rad": 0.5 + 0.66}, False),
        (DRIFTED, CERTAIN, {"heading_rad": 0.5 + 1.04}, True),
        (DRIFTED, CERTAIN, {"heading_rad": 0.5 + 1.06}, False),
        (CERTAIN, CERTAIN, {"heading_rad": 0.5 + 2 * math.pi}, True),  # unwrapped: the same
        (CERTAIN, CERTAIN, {"depth_m": 7.1}, True),
        (CERTAIN, CERTAIN, {"depth_m": 7.2}, False),
    ],
)
def test_a_jump_exceeds_both_the_vehicles_reach_and_the_filters_uncertainty(before, after, jump, accepted):
    gate = settled(**before)
    assert gate.check(at(1, **after, **jump)) == ("" if accepted else JUMPED)


def test_the_second_of_two_agreeing_outliers_is_accepted_and_others_never():
    gate = settled()
    assert gate.check(at(1, north_m=500.0)) == JUMPED
    assert gate.check(at(2, north_m=501.0)) == ""
    for k in range(3, 40):
        assert gate.check(at(k, north_m=500.0 + 1000.0 * k)) == JUMPED
    assert gate.check(at(40, north_m=501.0)) == ""
    assert gate.rejected == {JUMPED: 38}


def test_the_same_estimate_again_is_not_a_second_one():
    gate = settled()
    jumped = at(1, north_m=500.0)
    for _ in range(5):  # as a controller sees it whose cycles are faster than the estimates
        assert gate.check(jumped) == JUMPED
    assert gate.check(at(1, north_m=500.0)) == JUMPED
    assert gate.accepted.north_m == 1.0
    assert gate.rejected[JUMPED] == 2


def test_after_a_gap_every_position_within_reach_is_accepted():
    gate = settled(**CERTAIN)
    assert gate.check(at(100, north_m=40.0, **CERTAIN)) == ""  # 10 s at 4 m/s


def test_an_estimate_rejected_for_another_reason_does_not_confirm_a_jump():
    gate = settled()
    assert gate.check(at(1, north_m=500.0)) == JUMPED
    assert gate.check(at(2, north_m=500.0, yaw_rate_radps=math.nan)) != ""
    assert gate.check(at(3, north_m=500.0)) == JUMPED


@pytest.mark.parametrize(
    ("rates", "rejected_from_s"),
    [
        ({"velocity_north_mps": 0.2}, 0.3),
        ({"yaw_rate_radps": -0.1}, 0.6),
        ({"velocity_east_mps": 0.001}, 3.1),
        ({"velocity_east_mps": 1e-9}, None),  # at rest the same estimate may be true for ever
        ({}, None),
    ],
)
def test_an_estimate_that_repeats_an_earlier_one_with_another_stamp_is_rejected_once_it_cannot_be_true(
    rates, rejected_from_s
):
    gate = settled(**rates)
    reasons = [gate.check(at(k, **rates)) for k in range(1, 60)]
    first = next((k for k, reason in enumerate(reasons, 1) if reason), None)
    assert (first and first * PERIOD_NS * 1e-9) == (rejected_from_s and pytest.approx(rejected_from_s))
    assert all(reason == "an earlier one with another stamp" for reason in reasons[(first or 60) - 1 :])
    if first:
        assert "an earlier one with another stamp" in gate.health(60 * PERIOD_NS).why
        assert gate.check(at(60, north_m=1.01, **rates)) == ""
