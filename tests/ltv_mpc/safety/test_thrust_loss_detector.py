"""Thrust loss detector, against another solver and a fully known vehicle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from ltv_mpc.safety.thrust_loss_detector import (
    HIGHEST,
    LOWEST,
    MAX_GAIN_NATS,
    PAST_WEIGHT,
    PRIOR_SD,
    accumulate,
    constrained_minimum,
    evaluate,
    quadratic_form,
    recovery_gain,
    whitened,
)

NOTHING = np.zeros((6, 6))


def cycles(rng: np.random.Generator, count: int, x, loss=(0.0, 0.0)) -> np.ndarray:
    """Rows of cycles with different thrusts, of a vehicle whose mismatch c, s, b is ``x``."""
    rows = np.zeros((count, 7, 2))
    impulse, drag = rng.uniform(5.0, 15.0, (2, count)), rng.uniform(-4.0, 4.0, (count, 2))
    rows[:, 1] = impulse[0][:, None] * [1.0, 0.5]
    rows[:, 2] = impulse[1][:, None] * [1.0, -0.5]
    rows[:, 3] = drag
    of = [x[0] + loss[0], x[1] + loss[1], x[2]]
    rows[:, 0] = rng.normal(size=(count, 2)) + np.einsum("i,kia->ka", of, rows[:, 1:4])
    return rows


def products_of(rows: np.ndarray) -> np.ndarray:
    known = np.zeros((6, 6))
    for row in rows:
        accumulate(known, row)
    return known


@pytest.mark.parametrize("most_loss", [0.0, 1.0], ids=["no loss", "lost"])
@pytest.mark.parametrize("mass", range(LOWEST.shape[1]))
def test_the_minimum_agrees_with_another_solver(mass, most_loss):
    rng = np.random.default_rng(4 + mass)
    low = np.array([*LOWEST[:, mass], 0.0, 0.0])
    high = np.array([*HIGHEST[:, mass], most_loss, most_loss])
    size = [[3.0], [2.0], [1.0], [1.5], [0.5]]
    for _ in range(10):
        now, then = (np.vstack([rng.normal(size=12), rng.normal(size=(5, 12)) * size]) for _ in "ab")
        x = np.zeros(7)
        (form,) = quadratic_form((now @ now.T).reshape(1, -1), (then @ then.T).reshape(1, -1))
        ours = constrained_minimum(form, low, high, x)
        # f = |z - phi' (l, b, g) - phi' d|^2 + PAST_WEIGHT |z - phi' (l, b, g)|^2 + |(x, d)|^2 / PRIOR_SD^2
        mix = np.eye(5)
        mix[:2, :2] = [[1.0, 1.0], [1.0, -1.0]]  # l = c + s, c - s
        window = np.hstack([now[1:].T @ mix, now[1:3].T])
        before = math.sqrt(PAST_WEIGHT) * np.hstack([then[1:].T @ mix, np.zeros((12, 2))])
        A = np.vstack([window, before, np.eye(7) / PRIOR_SD])
        b = np.concatenate([now[0], math.sqrt(PAST_WEIGHT) * then[0], np.zeros(7)])
        theirs = lsq_linear(A, b, (low, np.maximum(high, 1e-9)), tol=1e-12)
        assert ours == pytest.approx(2.0 * theirs.cost, rel=5e-3)  # after ``MAX_SWEEPS``
        assert ours == pytest.approx(((b - A @ x) ** 2).sum(), rel=1e-9)


def test_whitened_rows_have_independent_noise_of_unit_variance():
    n = 7
    through = (np.eye(n, n + 1) - np.eye(n, n + 1, 1)) / math.sqrt(2.0)
    through = whitened(through)
    np.testing.assert_allclose(through @ through.T, np.eye(n), atol=1e-12)


def test_one_outlier_is_no_evidence():
    rng = np.random.default_rng(9)
    rows = cycles(rng, 10, (0.0, 0.0, 0.0))
    calm, *_ = evaluate(rows, NOTHING)
    rows[3, 0, 0] = 1e6
    wild, *_ = evaluate(rows, NOTHING)
    assert wild < calm + 5.0


@pytest.mark.parametrize("loss", [(0.5, 0.0), (0.0, 0.5)], ids=["port", "starboard"])
@pytest.mark.parametrize("x", [(0.0, 0.0, 0.0), (0.1, 0.02, -0.05)], ids=["no mismatch", "mismatch"])
def test_cycles_of_a_loss_speak_for_it_and_cycles_after_it_against_it(loss, x):
    rng = np.random.default_rng(7)
    past = products_of(cycles(rng, 200, x))
    of_loss, after = (
        np.mean([recovery_gain(row, past, np.array(loss)) for row in cycles(rng, 100, x, loss=of)])
        for of in (loss, (0.0, 0.0))
    )
    assert of_loss < -2.0
    assert after > 2.0


def test_thrusters_that_are_not_used_and_one_outlier_show_no_recovery():
    row = np.zeros((7, 2))
    assert recovery_gain(row, NOTHING, np.array([0.5, 0.0])) == 0.0
    row[1] = 1e3
    assert recovery_gain(row, NOTHING, np.array([0.5, 0.0])) == MAX_GAIN_NATS
