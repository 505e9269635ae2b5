"""Measurement update against the textbook equations, the gate, and the direction that no beam can see."""

import numpy as np
import pytest

from ltv_mpc.localisation.adaptive.failure_signatures import MAX_SD, FailureSignatures
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.filter.update import HEADING, correct, heading_coupling, reduce_covariance
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.sensor import Rows

CONFIG = EstimatorConfig()
LAYOUT = Layout.of(SensorConfig.load("paper"), CONFIG)
OPEN = 1e9


HYPOTHESES = 6


@pytest.fixture
def belief():
    """Random covariance, and random signatures of failure hypotheses."""
    rng = np.random.default_rng(0)
    belief = Belief.blank(LAYOUT, 0)
    root = rng.standard_normal((LAYOUT.size, LAYOUT.size)) / 10
    belief.P = root @ root.T
    belief.signatures = FailureSignatures.of(LAYOUT.size, HYPOTHESES)
    belief.signatures.error[:] = 0.1 * rng.standard_normal((LAYOUT.size, HYPOTHESES))
    belief.signatures.score[:] = rng.standard_normal(HYPOTHESES)
    return belief


def random_rows(m, touched=LAYOUT.size):
    """Return rows of the first ``touched`` states."""
    rng = np.random.default_rng(1)
    state = np.array([rng.choice(touched, 6, replace=False) for _ in range(m)])
    partial = rng.standard_normal((m, 6))
    partial[:, 4] = 0.0  # padding
    return Rows(state, partial, 0.1 * rng.standard_normal(m), rng.uniform(0.1, 2.0, m))


@pytest.mark.parametrize(("m", "touched"), [(1, LAYOUT.size), (5, LAYOUT.size), (120, LAYOUT.size), (120, 60)])
def test_an_update_is_the_textbooks(belief, m, touched):
    """K = P H^T (H P H^T + R)^-1 and Joseph form, followed by the invariant correction.

    A failure moves by the same gain; its score is the correlation of the innovations with what it would cause.
    """
    rows, P = random_rows(m, touched), belief.P.copy()
    E, score = belief.signatures.error.copy(), belief.signatures.score.copy()
    H, R = rows.times(np.eye(LAYOUT.size)), np.diag(rows.variance)
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    I_KH = np.eye(LAYOUT.size) - K @ H
    correction = correct(belief, rows, OPEN)
    assert correction.accepted.all()
    np.testing.assert_allclose(belief.x, K @ rows.residual, atol=1e-11)
    expected = I_KH @ P @ I_KH.T + K @ R @ K.T
    M = np.eye(LAYOUT.size)
    M[:, HEADING] += heading_coupling(belief.x, LAYOUT)
    expected = M @ expected @ M.T
    np.testing.assert_allclose(belief.P, expected, atol=1e-11)
    np.testing.assert_array_equal(belief.P, belief.P.T)
    np.testing.assert_allclose(correction.S, H @ P @ H.T + R, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(belief.signatures.error, M @ (E - K @ H @ E), atol=1e-10)
    seen = np.linalg.solve(correction.S, H @ E)
    np.testing.assert_allclose(belief.signatures.information, (H @ E).T @ seen, atol=1e-10)
    np.testing.assert_allclose(belief.signatures.score - score, seen.T @ rows.residual, atol=1e-10)


@pytest.mark.parametrize("m", [1, 30])
def test_one_message_adds_at_most_five_deviations_to_a_score(belief, m):
    rows = random_rows(m)
    rows.residual[:] = 1e3
    before = belief.signatures.score.copy()
    correct(belief, rows, OPEN)
    added = belief.signatures.score - before
    most = MAX_SD * np.sqrt(np.diagonal(belief.signatures.information))
    assert (np.abs(added) <= most * (1 + 1e-12)).all()
    assert np.abs(added / most).max() > 0.99


def test_a_row_beyond_the_gate_changes_nothing(belief):
    rows, without = random_rows(30), belief.copy()
    rows.residual[7] = 1e3
    keep = np.arange(30) != 7
    correction = correct(belief, rows, 10.8)
    correct(without, Rows(rows.state[keep], rows.partial[keep], rows.residual[keep], rows.variance[keep]), OPEN)
    np.testing.assert_array_equal(correction.accepted, keep)
    np.testing.assert_allclose(belief.x, without.x, atol=1e-13)
    np.testing.assert_allclose(belief.P, without.P, atol=1e-13)
    for name in ("error", "score", "information"):
        np.testing.assert_allclose(getattr(belief.signatures, name), getattr(without.signatures, name), atol=1e-10)


def test_rows_all_beyond_the_gate_leave_the_belief_as_it_was(belief):
    rows, before = random_rows(5), belief.copy()
    rows.residual[:] = 1e3
    assert not correct(belief, rows, 10.8).accepted.any()
    np.testing.assert_array_equal(belief.x, before.x)
    np.testing.assert_array_equal(belief.P, before.P)


@pytest.mark.parametrize("m", [1, 3])
def test_a_deweighted_row_is_used_with_the_noise_that_makes_it_just_pass(belief, m):
    rows, other, gate = random_rows(m), belief.copy(), 9.0
    S = np.diagonal(correct(belief.copy(), rows, OPEN).S)
    rows.residual[:] = 0.5 * np.sqrt(S)
    rows.residual[0] = 4.5 * np.sqrt(S[0])
    more = rows.variance.copy()
    more[0] += (4.5**2 / gate - 1.0) * S[0]
    correction = correct(belief, rows, gate, 36.0)
    correct(other, Rows(rows.state, rows.partial, rows.residual, more), OPEN)
    assert (correction.accepted.tolist(), correction.deweighted) == ([False] + [True] * (m - 1), 1)
    np.testing.assert_allclose(belief.x, other.x, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(belief.P, other.P, atol=1e-12)


@pytest.mark.parametrize("m", [1, 20])
def test_an_indefinite_covariance_is_reported_and_not_changed(belief, m):
    belief.P[:] = -10 * belief.P
    before = belief.copy()
    correction = correct(belief, random_rows(m), np.inf)
    assert not correction.definite
    assert not correction.accepted.any()
    np.testing.assert_array_equal(belief.P, before.P)
    np.testing.assert_array_equal(belief.x, before.x)


def turn(x):
    """Return the unobservable direction N(x)."""
    N = np.zeros(LAYOUT.size)
    N[8] = 1
    N[3:5] = -x[4], x[3]
    N[LAYOUT.mean] = -x[LAYOUT.mean][1], x[LAYOUT.mean][0]
    N[LAYOUT.north], N[LAYOUT.east] = -x[LAYOUT.east], x[LAYOUT.north]
    return N


def test_the_direction_of_a_common_turn_moves_with_the_estimate():
    rng = np.random.default_rng(0)
    x, dx = rng.standard_normal((2, LAYOUT.size))
    P = np.outer(turn(x), turn(x))
    reduce_covariance(P, np.empty((0, LAYOUT.size)), heading_coupling(dx, LAYOUT))
    np.testing.assert_allclose(P, np.outer(turn(x + dx), turn(x + dx)), atol=1e-12)
