"""The law that stops the vehicle: whatever moves comes to rest, inside box and slew."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ltv_mpc.control import grid
from ltv_mpc.control.damping import Damping
from ltv_mpc.vehicle.parameters import Vehicle

VEHICLES = {name: Vehicle.load(name) for name in ("paper", "low-yaw", "weak-reverse", "surface")}
SECONDS = 60


def stopped(vehicle: Vehicle, motion: tuple[float, float, float], command: tuple[float, float], knots: np.ndarray):
    X, U = np.zeros((len(knots), 8)), np.zeros((len(knots), 2))
    X[0, 2], X[0, 3], X[0, 5] = motion
    X[0, 6:] = U[0] = command
    Damping(vehicle, knots, 0.3).fill(X, U, np.zeros((len(knots), 2)), 0)
    return X, U


@pytest.mark.parametrize("name", VEHICLES)
@settings(max_examples=12, deadline=None)
@given(st.tuples(*[st.floats(-1, 1)] * 3), st.tuples(*[st.floats(0, 1)] * 2))
def test_surge_and_turn_come_to_rest_inside_box_and_slew(name, motion, shares):
    vehicle = VEHICLES[name]
    lateral = vehicle.thrusters[:2]
    low, high, slew = (np.array([getattr(t, f) for t in lateral]) for f in ("min_N", "max_N", "slew_N_per_s"))
    command = tuple(low + np.array(shares) * (high - low))
    X, U = stopped(vehicle, motion, command, np.arange(round(SECONDS / 0.3) + 1.0))
    assert (low <= U).all()
    assert (high >= U).all()
    assert (np.abs(np.diff(U, axis=0)) <= 0.3 * slew + 1e-9).all()
    assert abs(X[-1, 2]) < 0.02 + 0.1 * abs(motion[0])
    assert abs(X[-1, 5]) < 0.02
    assert np.abs(U[-1]).max() < 0.1 * high.max()


def test_it_stops_in_a_quarter_of_the_time_that_the_hull_s_drag_takes():
    """M u' = -D u |u| from 0.4 m/s leaves 0.4 / (1 + 0.4 t): 0.1 m/s after 7.5 s."""
    vehicle = VEHICLES["paper"]
    X, _ = stopped(vehicle, (0.4, 0.0, 0.0), (0.0, 0.0), np.arange(30.0))
    assert np.argmax(X[:, 2] < 0.1) * 0.3 < 7.5 / 2


def test_at_rest_it_does_nothing():
    X, U = stopped(VEHICLES["paper"], (0.0, 0.0, 0.0), (0.0, 0.0), np.arange(18.0))
    assert not U.any()
    assert not X.any()


def test_the_wanted_thrusts_give_the_wanted_force_and_moment():
    vehicle = VEHICLES["paper"]  # 500 kg, 179.049 kg m2, arms 0.2 m, lag 0.3 s: T = 1.2 s
    F1, F2 = Damping(vehicle, np.arange(3.0), 0.3).wanted(0.1, -0.05, 0.3)
    assert pytest.approx(-500 * 0.1 / 1.2) == F1 + F2
    assert pytest.approx(179.049 * 0.05 / 1.2) == 0.2 * (F1 - F2)


def test_stages_that_grow_do_not_make_it_swing():
    X, U = stopped(VEHICLES["paper"], (0.4, 0.1, 0.3), (0.0, 0.0), grid.knots(34, 200.0))
    assert np.abs(U[-1]).max() < 2.0
    assert abs(X[-1, 2]) < 0.05
    assert X[:, 2].min() > -0.15


def test_what_stands_up_to_a_knot_stays():
    vehicle, knots = VEHICLES["paper"], np.arange(18.0)
    X, U = stopped(vehicle, (0.3, 0.0, 0.2), (10.0, -10.0), knots)
    X[5:], U[5:] = np.nan, np.nan
    before = X[:5].copy(), U[:5].copy()
    Damping(vehicle, knots, 0.3).fill(X, U, np.zeros((18, 2)), 4)
    np.testing.assert_array_equal(X[:5], before[0])
    np.testing.assert_array_equal(U[:5], before[1])
    assert np.isfinite(X).all()
