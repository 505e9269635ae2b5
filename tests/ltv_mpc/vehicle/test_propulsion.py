"""Propellers: thrust and revolutions (eq 8), and power against numbers computed by hand and the open-water curve."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.propulsion import propulsive_power_W, relative_power, shaft_power_W
from ltv_mpc.vehicle.thruster import revolutions, thrust
from tests.ltv_mpc.vehicles import changed

PAPER = Vehicle.load("paper")  # d = 0.25 m, K_Q = 0.056 - 0.042 J, 1025 kg/m3
RHO, D = 1025.0, 0.25


@given(st.floats(-62.5, 62.5), st.floats(-1.0, 1.0))
def test_thrust_to_revolutions_and_back_is_the_same_thrust(F, inflow):
    assert thrust(revolutions(F, inflow, RHO, D), inflow, RHO, D) == pytest.approx(F, rel=1e-9, abs=1e-9)


def test_the_bilinear_form_has_its_coefficients():
    # 0.4 x 1025 x 0.25^4 = 1.6016; (1/3) x 1025 x 0.25^3 = 5.3385
    assert thrust(2.0, 0.0, RHO, D) == pytest.approx(1.601562 * 4, rel=1e-5)
    assert thrust(2.0, 0.5, RHO, D) == pytest.approx(1.601562 * 4 - 5.338542 * 0.5 * 2, rel=1e-5)
    assert thrust(-2.0, 0.5, RHO, D) == pytest.approx(-1.601562 * 4 - 5.338542 * 0.5 * 2, rel=1e-5)


def test_a_small_thrust_against_the_inflow_needs_reverse_revolutions():
    """With inflow from ahead two positive n give the same small negative thrust; the propeller reverses instead."""
    assert revolutions(-0.5, 0.5, RHO, D) < 0.0
    assert revolutions(0.5, 0.5, RHO, D) > 0.0
    assert revolutions(0.0, 0.5, RHO, D) == 0.0


@pytest.mark.parametrize(
    ("thrust_N", "inflow_mps", "power_W"),
    [
        (62.5, 0.0, 85.86),  # n = 6.2469 /s: 2 pi x 0.056 x 1025 x 0.25^5 x 243.78
        (-62.5, 0.0, 85.86),
        (62.5, 0.5, 101.06),  # n = 7.1356 /s, Q = 2.8541 - 0.6000 = 2.2542 N m
        (-62.5, 0.5, 73.41),  # n = -5.4690 /s, Q = -1.6766 - 0.4598 = -2.1364 N m
        (0.0, 0.5, 0.0),
    ],
)
def test_the_power_is_that_computed_by_hand(thrust_N: float, inflow_mps: float, power_W: float) -> None:
    power = shaft_power_W(np.array([thrust_N]), np.array([inflow_mps]), PAPER.thruster.port, RHO)
    assert power[0] == pytest.approx(power_W, abs=0.006)


@given(st.floats(-15.0, 15.0).filter(lambda n: abs(n) > 0.01), st.floats(-1.5, 1.5))
def test_the_power_is_that_of_the_revolutions_that_give_the_thrust(n: float, inflow_mps: float) -> None:
    """Efficiency F v / P never exceeds 1, whatever the propeller does."""
    F = thrust(n, inflow_mps, RHO, 0.25)
    power = shaft_power_W(np.array([F]), np.array([inflow_mps]), PAPER.thruster.port, RHO)[0]
    assert power >= 0.0
    if F * n > 0.0:  # else the same thrust has other revolutions too
        torque = RHO * 0.25**5 * (0.056 * abs(n) * n - 0.042 * inflow_mps / 0.25 * abs(n))
        assert power == pytest.approx(max(2.0 * np.pi * n * torque, 0.0), rel=1e-6, abs=1e-6)
        assert F * inflow_mps <= power + 1e-9


@pytest.mark.parametrize("name", ["paper", "surface", "low-yaw", "weak-reverse"])
def test_every_shipped_vehicle_has_the_power_of_all_its_thrusters(name: str) -> None:
    vehicle = Vehicle.load(name)
    power = propulsive_power_W(vehicle, np.full((2, 3), 20.0), np.zeros(2), np.zeros(2))
    assert power is not None
    assert (power[:, :2] > 0.0).all()
    assert (power[:, 2] > 0.0).all() == vehicle.can_dive


def test_the_inflow_of_the_vertical_propeller_is_the_sinking_speed() -> None:
    power = propulsive_power_W(PAPER, np.full((1, 3), 62.5), np.zeros(1), np.array([0.5]))
    assert power is not None
    np.testing.assert_allclose(power[0], [85.86, 85.86, 101.06], atol=0.006)


def test_without_torque_coefficients_there_is_no_power() -> None:
    bare = msgspec.structs.replace(PAPER.thruster.port, torque_coefficient=None, torque_inflow_coefficient=None)
    vehicle = changed(PAPER, {"thruster.port": bare})
    assert propulsive_power_W(vehicle, np.zeros((1, 3)), np.zeros(1), np.zeros(1)) is None


def test_the_relative_power_is_one_at_full_thrust_and_grows_as_thrust_to_1_5() -> None:
    relative = relative_power(PAPER, np.array([[62.5, -62.5], [62.5, 0.0], [15.625, 15.625], [0.0, 0.0]]))
    np.testing.assert_allclose(relative, [1.0, 0.5, 0.125, 0.0])


def test_the_relative_power_of_thrusters_that_are_weak_astern_counts_the_larger_side() -> None:
    weak = Vehicle.load("weak-reverse")
    assert relative_power(weak, np.full((1, 2), weak.thruster.port.max_N)).item() == 1.0
    assert relative_power(weak, np.full((1, 2), weak.thruster.port.min_N)).item() < 1.0
