"""Propeller model (eq 8): thrust to revolutions and back, with inflow."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ltv_mpc.vehicle.thruster import revolutions, thrust

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
