"""Comparison of planned with simulated dives: the luck of the satellite displacement is removed."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.dive_plan import equal_noise


def test_the_drift_with_equal_noise_does_not_depend_on_the_luck_of_the_noise() -> None:
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((40, 2))
    rest = rng.standard_normal((40, 2))
    rest -= noise * (noise * rest).sum(axis=0) / np.square(noise).sum(axis=0)  # orthogonal to the noise
    expected = np.sqrt(9.0 + np.square(rest).mean())
    for luck in (0.8, 1.0, 1.3):
        drift_m = 3.0 * luck * noise + rest
        assert equal_noise(drift_m, luck * noise) == pytest.approx(expected, rel=1e-12)
