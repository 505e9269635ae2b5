"""Judgement of mean squares: draws of known distribution, constant or independent over a run."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.localisation_check.judgement import holm, judge, mean_square, p_of_mean
from benchmarks.localisation_check.probe import Squares

INSTANTS = 200


def runs_of(
    rng: np.random.Generator, runs: int, *, constant: bool, factor: float = 1.0, dof: int = 3, instants: int = INSTANTS
) -> list[Squares]:
    """Return runs whose squares are one draw repeated, or one draw per instant."""
    t, n = np.arange(instants) * 1_000_000_000, np.full(instants, dof)
    drawn = factor * rng.chisquare(dof, (runs, 1 if constant else instants))
    return [Squares(t, one, n) for one in np.broadcast_to(drawn, (runs, instants))]


def test_a_standard_error_counts_runs_and_not_instants() -> None:
    runs = runs_of(np.random.default_rng(5), 40, constant=True)
    mean = mean_square(runs)
    values = np.array([run.square.mean() / 3 for run in runs])
    assert mean.value == pytest.approx(values.mean())
    assert mean.standard_error == pytest.approx(values.std(ddof=1) / math.sqrt(40))
    assert math.isnan(mean_square(runs[:1]).standard_error)
    assert p_of_mean(mean_square(runs[:1])) == 1.0


@pytest.mark.parametrize("runs", [5, 40])
@pytest.mark.parametrize("constant", [True, False])
def test_consistent_squares_are_rejected_as_rarely_as_the_level_says(runs: int, constant: bool) -> None:
    """Ten means are judged together: at 1 % of 100 checks 1 is rejected in the mean.

    With 200 instants the means of independent draws would nearly all be within the tolerance, and never be rejected.
    """
    rng = np.random.default_rng([7, runs, constant])
    rejected = 0
    for _ in range(100):
        means = [mean_square(runs_of(rng, runs, constant=constant, dof=1, instants=20)) for _ in range(10)]
        rejected += any(one.rejected for one in judge([("", mean.value, "", p_of_mean(mean)) for mean in means]))
    assert rejected <= 5


@pytest.mark.parametrize("factor", [1.3**2, 1.3**-2])
def test_a_noise_that_is_off_by_thirty_per_cent_is_rejected(factor: float) -> None:
    """Twenty runs of white squares, beside 18 other hypotheses."""
    mean = mean_square(runs_of(np.random.default_rng(8), 20, constant=False, factor=factor))
    assert judge([("", mean.value, "", p_of_mean(mean)), *[("", 1.0, "", 1.0)] * 18])[0].rejected


def test_p_values_are_adjusted_by_the_method_of_holm() -> None:
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03, 0.005]), [0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, 0.9]).tolist() == [1.0, 1.0]
