"""Reference point: estimates of any point of the vehicle become those of its origin, and plans go the other way."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import Array, Estimate, Plan
from ltv_mpc.references import Point
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.reference_point import ORIGIN, ReferencePoint
from tests.ltv_mpc import plans
from tests.ltv_mpc.control.flights import ARM, Flight

POINT = ReferencePoint(forward_m=0.5, starboard_m=-0.3, down_m=0.7)
FIELDS = ("north_m", "east_m", "velocity_north_mps", "velocity_east_mps", "heading_rad", "yaw_rate_radps")
metres, angles, rates = st.floats(-50, 50), st.floats(-7, 7), st.floats(-2, 2)


def estimate_of(states: Array, covariance: Array | None = None) -> Estimate:
    """Return the estimate with these states (6,), in the order of a covariance."""
    values = dict(zip(FIELDS, map(float, states), strict=True))
    return msgspec.structs.replace(Estimate.at_rest(depth_m=10.0), covariance=covariance, **values)


def states_of(estimate: Estimate) -> Array:
    return np.array([getattr(estimate, name) for name in FIELDS])


def position_at(states: Array, dt_s: float) -> complex:
    """Return the position of POINT, north + i east, of a vehicle whose origin has these states, ``dt_s`` later."""
    north, east, vn, ve, heading, r = states
    arm = complex(POINT.forward_m, POINT.starboard_m)
    return complex(north + vn * dt_s, east + ve * dt_s) + arm * np.exp(1j * (heading + r * dt_s))


def measured_at(origin: Array, h: float = 1e-4) -> Estimate:
    """Return the estimate of POINT: its velocity is the derivative of its position, here a central difference."""
    position, velocity = position_at(origin, 0.0), (position_at(origin, h) - position_at(origin, -h)) / (2 * h)
    return estimate_of(np.array([position.real, position.imag, velocity.real, velocity.imag, *origin[4:]]))


@given(st.tuples(metres, metres, rates, rates, angles, rates))
def test_position_and_velocity_of_a_point_become_those_of_the_origin(states: tuple[float, ...]) -> None:
    origin = np.array(states)
    measured = measured_at(origin)
    found = POINT.to_origin(measured)
    np.testing.assert_allclose(states_of(found), origin, atol=1e-6)
    assert found.depth_m == pytest.approx(10.0 - 0.7)
    seen = POINT.to_origin(msgspec.structs.replace(measured, altitude_m=3.0))
    assert seen.altitude_m == pytest.approx(3.0 + 0.7)  # the bottom stays where it is
    assert found.altitude_m is None


def test_a_node_with_a_declared_point_plans_as_one_with_estimates_of_the_origin() -> None:
    paper, origin = Vehicle.load("paper"), np.array([3.0, -2.0, 0.2, 0.1, 1.1, 0.05])

    def plan(vehicle: Vehicle, depth_m: float, estimate: Estimate) -> Plan:
        node = ControllerNode(vehicle, Point(north_m=0.0, east_m=0.0), ControllerConfig())
        made = Flight(None, node=node).run(0, ARM, msgspec.structs.replace(estimate, depth_m=depth_m))
        assert made is not None
        return made

    told = plan(msgspec.structs.replace(paper, reference_point=POINT), 10.7, measured_at(origin))
    right = POINT.of_plan(plan(paper, 10.0, estimate_of(origin)))
    assert np.abs(told.thrust_N).max() > 10.0
    np.testing.assert_allclose(told.thrust_N, right.thrust_N, atol=1e-3)
    np.testing.assert_allclose(told.states, right.states, atol=1e-4)
    assert told.reference_m == pytest.approx(right.reference_m)


def test_its_covariance_is_transformed_by_the_derivative_of_the_conversion() -> None:
    """With a heading that is correlated with the position, so that terms can cancel."""
    states = np.array([3.0, -2.0, 0.4, 0.1, 1.1, 0.3])
    L = np.tril(np.random.default_rng(1).normal(size=(6, 6)))
    h = 1e-6
    J = np.stack(
        [
            (states_of(POINT.to_origin(estimate_of(states + d))) - states_of(POINT.to_origin(estimate_of(states - d))))
            / (2 * h)
            for d in h * np.eye(6)
        ],
        axis=1,
    )
    found = POINT.to_origin(estimate_of(states, L @ L.T)).covariance
    np.testing.assert_allclose(found, J @ L @ L.T @ J.T, atol=1e-6)


def test_without_a_reference_point_estimates_and_plans_stay_as_they_are() -> None:
    estimate, plan = Estimate.at_rest(), plan_of(np.zeros((2, 6)))
    assert ORIGIN.to_origin(estimate) is estimate
    assert ORIGIN.of_plan(plan) is plan


def plan_of(states: Array, **fields: object) -> Plan:
    return plans.plan_of(0, np.zeros((len(states), 3)), states=states, **fields)


def test_states_of_a_plan_come_back_as_estimates_of_the_same_motion() -> None:
    """A plan's velocity is through the water; here the water is still, so it is also over ground."""
    states = np.random.default_rng(2).normal(size=(5, 6))
    told = POINT.of_plan(plan_of(states)).states
    for origin, point in zip(states, told, strict=True):
        v = complex(*point[2:4]) * np.exp(1j * point[4])
        found = POINT.to_origin(estimate_of(np.array([*point[:2], v.real, v.imag, *point[4:]])))
        through = complex(found.velocity_north_mps, found.velocity_east_mps) * np.exp(-1j * point[4])
        np.testing.assert_allclose([found.north_m, found.east_m, through.real, through.imag], origin[:4], atol=1e-12)


def test_the_target_of_a_plan_is_where_the_point_belongs() -> None:
    """The vehicle looks east: ahead is east, to port is north."""
    states = np.zeros((2, 6))
    states[:, 4] = math.pi / 2
    plan = POINT.of_plan(plan_of(states, reference_m=(20.0, 30.0), reference_depth_m=5.0, depth_limit_m=4.0))
    assert plan.reference_m == pytest.approx((20.3, 30.5))
    assert plan.reference_depth_m == pytest.approx(5.7)
    assert plan.depth_limit_m == pytest.approx(4.7)
