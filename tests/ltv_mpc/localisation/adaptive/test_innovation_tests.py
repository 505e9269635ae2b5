"""Test of the innovation mean: chi-square distribution, and influence of a single bad message."""

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from ltv_mpc.localisation.adaptive.process_noise import MAX_SD, InnovationMeanTest, threshold

SECOND = 1_000_000_000
TAU_S = (1.0, 3.0, 10.0)
V = np.array([[2e-4, 5e-5], [5e-5, 1e-4]])


def heard(rng, messages=60, mean=(0.0, 0.0), V_of=lambda _: V):
    """Return a test after contrasts with this mean, three a second."""
    sums = InnovationMeanTest(TAU_S, 2)
    for k in range(messages):
        d = np.array(mean) + np.linalg.cholesky(V_of(k)) @ rng.standard_normal(2)
        sums.add(k * SECOND // 3, d, V_of(k))
    return sums


def test_white_innovations_have_their_chi_square_at_every_time_constant():
    """The variance may change over time."""
    rng = np.random.default_rng(0)
    draws = np.array([heard(rng, V_of=lambda k: V * (1 + k % 7)).chi_square() for _ in range(300)])
    for one in draws.T:
        assert kstest(one, chi2(2).cdf).pvalue > 1e-3


def test_a_small_mean_of_a_hundred_rows_is_detected_within_seconds_and_none_is_not():
    """Mean of one standard deviation per message: after 9 messages the sum is 9, its standard deviation 3."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        assert (heard(rng, mean=np.sqrt(np.diagonal(V)) * 1.5, messages=30).chi_square() > threshold(2)).any()
        assert (heard(rng).chi_square() < threshold(2)).all()


def test_one_wrong_message_does_not_exceed_the_threshold_and_two_do():
    sums = InnovationMeanTest(TAU_S, 2)
    sums.add(0, np.array([1e3, -1e3]), V)
    assert sums.chi_square() == pytest.approx([MAX_SD**2] * 3)
    assert threshold(2) > MAX_SD**2
    sums.add(SECOND // 3, np.array([1e3, -1e3]), V)
    assert (sums.chi_square() > threshold(2)).all()
