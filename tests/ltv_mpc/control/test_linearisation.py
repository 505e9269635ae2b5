"""The motion over the horizon: stage upon stage, to first order, and over ground."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc import Vehicle
from ltv_mpc.control.linearisation import (
    Linearisation,
    describe_non_finite,
    linearise,
    linearise_along,
    propagate,
    roll_out,
)
from ltv_mpc.vehicle.flow import advance_stage, lag_table

P = Vehicle.load("paper").coefficients()
N = 3


def trajectory(seed):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(N + 1, 8)) * [3, 3, 0.3, 0.2, 2, 0.3, 30, 30]
    return X, rng.uniform(-60, 60, (N + 1, 2)), 0.1 * rng.normal(size=(N + 1, 2))


def test_a_roll_out_is_one_stage_after_another_each_of_its_own_length():
    X, U, C = trajectory(1)
    lengths = np.array([0.3, 0.17, 0.45])
    rolled = roll_out(X[0], U, C, lengths, P)
    assert rolled.shape == (N + 1, 8)
    x = X[0].copy()
    np.testing.assert_array_equal(rolled[0], x)
    for k, h in enumerate(lengths):
        after = np.empty(8)
        advance_stage(x, U[k], U[k + 1], C[k], C[k + 1], h, P, lag_table(h, P), after)
        np.testing.assert_allclose(rolled[k + 1], after, rtol=1e-12, atol=1e-12)
        x = after


def test_the_linearisation_foresees_each_stage_from_a_point_nearby():
    """What is left after the first order shrinks with the square of the distance."""
    X, U, C = trajectory(2)
    lin = linearise(X, U, C, 0.3, P)
    assert lin.Phi.shape == (N, 8)
    rng = np.random.default_rng(3)
    for k in range(N):
        dX, dU0, dU1 = rng.normal(size=8) * [1, 1, 0.1, 0.1, 0.3, 0.1, 10, 10], rng.normal(size=2), rng.normal(size=2)
        size = 1e-4
        commands = np.array([U[k] + size * dU0, U[k + 1] + size * dU1])
        exact = roll_out(X[k] + size * dX, commands, C[k : k + 2], np.array([0.3]), P)[1]
        foreseen = lin.Phi[k] + size * (lin.A[k] @ dX + lin.B0[k] @ dU0 + lin.B1[k] @ dU1)
        np.testing.assert_allclose(foreseen, exact, atol=1e-7)


def test_along_a_roll_out_there_is_no_gap():
    X, U, C = trajectory(5)
    knots = np.array([0.0, 1.0, 1.7, 3.2])
    lin = Linearisation.empty(N)
    lin.X[0], lin.U[...], lin.C[...] = X[0], U, C
    propagate(lin.X, U, C, knots, 0.3, P)
    linearise_along(lin, knots, 0.3, np.array(P))
    np.testing.assert_array_equal(lin.X[1:], lin.Phi)


@pytest.mark.parametrize("name", [*Linearisation._fields, "target"])
def test_an_input_that_is_not_finite_is_named_with_its_first_index(name):
    lin, target = linearise(*trajectory(7), 0.3, P), np.zeros((N + 1, 2))
    lin = Linearisation(*map(np.copy, lin))
    assert describe_non_finite(lin, target) == "the QP's numbers are not finite"
    values = target if name == "target" else getattr(lin, name)
    values[1].flat[-1] = np.inf
    values[2] = np.nan
    assert describe_non_finite(lin, target) == f"{name} is not finite from index 1 on"
