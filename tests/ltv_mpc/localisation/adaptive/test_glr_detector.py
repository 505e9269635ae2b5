"""GLR detector: the most likely hypothesis, and compensation by the mixture of all."""

import numpy as np
import pytest

from ltv_mpc.localisation.adaptive.failure_signatures import FailureSignatures
from ltv_mpc.localisation.adaptive.glr_detector import COLUMNS, STEP_NS, STEPS, THRESHOLD, GlrDetector
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import VELOCITY, Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig

LAYOUT = Layout.of(SensorConfig.load("paper"), EstimatorConfig())
N = LAYOUT.size
REACH_NS = 10_000_000_000
SD = 0.01


def has_started(steps):
    """Return a belief after some steps of the time grid, with random signatures, and its detector."""
    rng = np.random.default_rng(0)
    belief, onsets = Belief.blank(LAYOUT, 0), GlrDetector()
    belief.signatures = FailureSignatures.of(N, COLUMNS)
    for k in range(steps):
        belief.t_ns = k * STEP_NS
        onsets.start_hypothesis(belief)
    root = rng.standard_normal((COLUMNS, COLUMNS))
    belief.signatures.information[:] = 1e5 * (root @ root.T + 3 * np.eye(COLUMNS))
    belief.signatures.error[:] = rng.standard_normal((N, COLUMNS))
    return belief, onsets


def slots(k):
    return [2 * (k % STEPS), 2 * (k % STEPS) + 1]


def hypothesis(began, ended=None):
    """Return the selection matrix (K, 2) of a hypothesis."""
    D = np.zeros((COLUMNS, 2))
    D[slots(began), [0, 1]] = 1.0
    if ended is not None:
        D[slots(ended), [0, 1]] = -1.0
    return D


def test_signatures_grow_from_their_start_and_the_oldest_is_replaced():
    belief, onsets = Belief.blank(LAYOUT, 0), GlrDetector()
    belief.signatures = FailureSignatures.of(N, COLUMNS)
    for k in range(STEPS + 3):
        belief.t_ns = k * STEP_NS
        onsets.start_hypothesis(belief)
        onsets.add_elapsed(1.0)
        onsets.add_elapsed(2.0)
    belief.t_ns += STEP_NS // 2
    onsets.start_hypothesis(belief)
    E = belief.signatures.error
    for k in range(3, STEPS + 3):
        north, east = slots(k)
        duration_s = 3.0 * (STEPS + 3 - k)
        for column, axis, nodes in ((north, 0, LAYOUT.north), (east, 1, LAYOUT.east)):
            expected = np.zeros(N)
            expected[nodes] = expected[LAYOUT.mean.start + axis] = duration_s
            np.testing.assert_allclose(E[:, column], expected)


@pytest.mark.parametrize(("truth", "old"), [((2, 5), True), ((4, None), True), ((9, None), False), ((8, 10), False)])
def test_estimate_and_covariance_become_those_of_the_mixture_of_all(truth, old):
    """Reference: sum over all hypotheses with textbook formulas. Twelve instants, three within the filter's buffer."""
    belief, onsets = has_started(12)
    J, E = belief.signatures.information, belief.signatures.error
    belief.signatures.score[:] = J @ hypothesis(*truth) @ np.array([0.012, -0.02])
    mean, second, total, best = np.zeros(N), np.zeros((N, N)), 0.0, 0.0
    every = [hypothesis(i, k) for i in range(12) for k in (None, *range(i + 1, 12))]
    found = []
    for D in every:
        d, own = D.T @ belief.signatures.score, D.T @ J @ D
        covariance = np.linalg.inv(own + np.eye(2) / SD**2)
        twice = d @ covariance @ d
        evidence = 0.5 * twice - 0.5 * np.log(np.linalg.det(np.eye(2) + SD**2 * own))
        found.append((evidence, E @ D @ covariance @ d, E @ D @ covariance @ D.T @ E.T))
        best = max(best, twice)
    highest = max(evidence for evidence, _, _ in found)
    for evidence, move, spread in found:
        share = np.exp(evidence - highest)
        total += share
        mean += share * move
        second += share * (spread + np.outer(move, move))
    mean /= total
    P = second / total - np.outer(mean, mean) + 0.15**2 * np.outer(mean, mean)
    assert best > THRESHOLD
    result = onsets.detect(belief, THRESHOLD, REACH_NS)
    np.testing.assert_allclose(result.error, mean, atol=2e-3 * np.abs(mean).max())
    np.testing.assert_allclose(result.root @ result.root.T, P, atol=2e-2 * np.abs(P).max())
    assert result.is_old == old
    before = belief.P.copy()
    result.compensate(belief)
    np.testing.assert_allclose(belief.x[VELOCITY], result.error[VELOCITY])
    np.testing.assert_allclose(belief.P - before, result.root @ result.root.T)
    assert onsets.detect(belief, best + 1.0, REACH_NS) is None


def test_nothing_is_detected_after_a_reset_or_without_hypotheses():
    belief, onsets = has_started(12)
    belief.signatures.score[:] = belief.signatures.information @ hypothesis(3) @ np.full(2, 0.05)
    assert onsets.detect(belief, THRESHOLD, REACH_NS) is not None
    onsets.reset(belief)
    assert onsets.detect(belief, 0.0, REACH_NS) is None
    assert not belief.signatures.score.any()
    blank = Belief.blank(LAYOUT, 0)
    onsets.start_hypothesis(blank)
    assert onsets.detect(blank, 0.0, REACH_NS) is None
