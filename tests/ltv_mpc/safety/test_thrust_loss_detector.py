"""Thrust loss detector, against another solver and a fully known vehicle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from ltv_mpc.safety.thrust_loss_detector import (
    DIFFERENCE_SD,
    MAX_GAIN_NATS,
    MISMATCH_SD,
    PAST_WEIGHT,
    PRIOR_SD,
    ThrustLossDetector,
    losses,
    quadratic_form,
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


def after(rows: np.ndarray, products: np.ndarray = NOTHING) -> tuple[ThrustLossDetector, tuple[float, float, float]]:
    """Return a detector that knows the products and has taken these cycles, and its last result."""
    detector = ThrustLossDetector()
    detector.restore(products)
    return detector, [detector.add(row, learn=True) for row in rows][-1]


def products_of(rows: np.ndarray) -> np.ndarray:
    detector, _ = after(rows)
    return detector.products


def gain_of(row: np.ndarray, products: np.ndarray, loss) -> float:
    detector, _ = after(row[None], products)
    return detector.recovery_gain(loss)


def test_the_minima_agree_with_another_solver():
    rng = np.random.default_rng(4)
    size = [[3.0], [2.0], [1.0], [1.5], [0.5]]
    # mass, thrust and drag are wrong independently, c = m - t and b = q - m
    mix = MISMATCH_SD * np.array([[1.0, -1.0, 0.0], [-1.0, 0.0, 1.0]])
    prior = np.diag([0.0, 1.0 / DIFFERENCE_SD, 0.0, *[1.0 / PRIOR_SD] * 4])
    prior[0:3:2, 0:3:2] = np.linalg.cholesky(np.linalg.inv(mix @ mix.T)).T
    sides = np.eye(5)
    sides[:2, :2] = [[1.0, 1.0], [1.0, -1.0]]  # l = c + s, c - s
    for _ in range(40):
        now, then = (np.vstack([rng.normal(size=12), rng.normal(size=(5, 12)) * size]) for _ in "ab")
        (found,) = losses(quadratic_form((now @ now.T).reshape(1, -1), (then @ then.T).reshape(1, -1)))
        # f = |z - phi' (l, b, g) - phi' d|^2 + PAST_WEIGHT |z - phi' (l, b, g)|^2 + prior
        window = np.hstack([now[1:].T @ sides, now[1:3].T])
        before = math.sqrt(PAST_WEIGHT) * np.hstack([then[1:].T @ sides, np.zeros((12, 2))])
        A = np.vstack([window, before, prior])
        b = np.concatenate([now[0], math.sqrt(PAST_WEIGHT) * then[0], np.zeros(7)])
        without = 2.0 * lsq_linear(A[:, :5], b).cost
        for (gain, *loss), most in zip(found, ((1.0, 1e-9), (1e-9, 1.0), (1.0, 1.0)), strict=True):
            theirs = lsq_linear(A, b, ([-np.inf] * 5 + [0.0, 0.0], [np.inf] * 5 + [*most]), tol=1e-12)
            if most != (1.0, 1.0) or 0.0 < min(loss) <= max(loss) < 1.0:
                assert without - gain == pytest.approx(2.0 * theirs.cost, rel=1e-6)
                np.testing.assert_allclose(loss, theirs.x[5:], atol=1e-4)
            assert without - gain >= 2.0 * theirs.cost - 1e-6


def test_whitened_rows_have_independent_noise_of_unit_variance():
    n = 7
    through = (np.eye(n, n + 1) - np.eye(n, n + 1, 1)) / math.sqrt(2.0)
    through = whitened(through)
    np.testing.assert_allclose(through @ through.T, np.eye(n), atol=1e-12)


@pytest.mark.parametrize("loss", [(0.5, 0.0), (0.0, 0.5), (0.5, 0.5)], ids=["port", "starboard", "both"])
def test_a_loss_of_one_thruster_is_attributed_to_it_alone(loss):
    rng = np.random.default_rng(5)
    rows = cycles(rng, 9, (0.0, 0.0, 0.0), loss=loss)
    _, (_, *found) = after(rows, products_of(cycles(rng, 230, (0.0, 0.0, 0.0))))
    np.testing.assert_allclose(found, loss, atol=0.1)
    assert [share == 0.0 for share in found] == [share == 0.0 for share in loss]


def test_one_outlier_is_no_evidence():
    rng = np.random.default_rng(9)
    rows = cycles(rng, 10, (0.0, 0.0, 0.0))
    _, (calm, *_) = after(rows)
    rows[3, 0, 0] = 1e6
    _, (wild, *_) = after(rows)
    assert wild < calm + 5.0


@pytest.mark.parametrize("loss", [(0.5, 0.0), (0.0, 0.5)], ids=["port", "starboard"])
@pytest.mark.parametrize("x", [(0.0, 0.0, 0.0), (0.1, 0.02, -0.05)], ids=["no mismatch", "mismatch"])
def test_cycles_of_a_loss_speak_for_it_and_cycles_after_it_against_it(loss, x):
    rng = np.random.default_rng(7)
    past = products_of(cycles(rng, 230, x))
    of_loss, after = (
        np.mean([gain_of(row, past, loss) for row in cycles(rng, 100, x, loss=of)]) for of in (loss, (0.0, 0.0))
    )
    assert of_loss < -2.0
    assert after > 2.0


def test_thrusters_that_are_not_used_and_one_outlier_show_no_recovery():
    row = np.zeros((7, 2))
    assert gain_of(row, NOTHING, (0.5, 0.0)) == 0.0
    row[1] = 1e3
    assert gain_of(row, NOTHING, (0.5, 0.0)) == MAX_GAIN_NATS
