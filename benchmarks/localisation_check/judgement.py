"""Statistical judgement of the localisation check: mean squares clustered by run, at one family-wise level.

Runs are independent, the instants of one run are not. With S_r the sum of squares of run r and n_r its degrees of
freedom, the mean square m and its relative variance are those of a ratio estimate (Cochran 1977, section 2.11):

    m = sum S_r / sum n_r,    c^2 = R / (R - 1) sum (S_r - m n_r)^2 / (m sum n_r)^2

If sigma is right, m is distributed as chi2_nu / nu with nu = 2 / c^2 (Satterthwaite 1946). nu is at least what constant
errors have, one instant of each run, and at most the sum of all n_r. The cube root of m is nearly normal (Wilson &
Hilferty 1931); as c is estimated from R runs, the p-value is that of Student's t with R - 1 degrees of freedom.

A hypothesis is rejected by the method of Holm (1979), at ``LEVEL`` for all hypotheses of a check together: the smallest
of k p-values is multiplied by k, the next by k - 1, and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.stats import binom, chi2
from scipy.stats import t as student

from benchmarks.localisation_check.probe import Squares
from ltv_mpc.messages import Array

LEVEL = 0.01
"""Probability that a check of a filter that meets all requirements fails."""

TOLERANCE = 0.05
"""Relative error of a mean square that is accepted: 2.5 % of sigma. The filter linearises, and its water has cells."""

MIN_SHARE = 0.9
"""Smallest share of instants inside the 95 % band."""

MIN_DRAWS = 100.0
"""Independent draws of a run over time from which a share of instants is judged. Of one draw it is 0 or 100 %."""


class Mean(NamedTuple):
    """Mean square per degree of freedom of one quantity over the runs."""

    value: float
    standard_error: float  # NaN with one run
    nu: float  # effective degrees of freedom of all runs
    draws: float  # independent draws of one run over time
    runs: int


class Hypothesis(msgspec.Struct, frozen=True, kw_only=True):
    """Requirement of the check, and the evidence against it."""

    name: str
    observed: float
    limit: str
    p: float  # adjusted by the method of Holm
    rejected: bool  # p is below ``LEVEL``


def mean_square(runs: Sequence[Squares]) -> Mean:
    """Return the mean square of a quantity with its clustered standard error."""
    have = [run for run in runs if run.dof.sum() > 0]
    S, n = np.array([run.square.sum() for run in have]), np.array([float(run.dof.sum()) for run in have])
    m, R = float(S.sum() / n.sum()), len(have)
    instants = np.array([len(np.unique(run.t_ns[run.dof > 0])) for run in have])
    constant = float((n / instants).sum())
    if R < 2:
        return Mean(m, float("nan"), constant, 1.0, R)
    left = S - m * n
    c = float(np.sqrt(R / (R - 1) * (left @ left)) / (m * n.sum())) if m > 0 else 0.0
    nu = float(np.clip(2.0 / max(c * c, 1e-12), constant, n.sum()))
    return Mean(m, m * c, nu, nu / constant, R)


def p_of_mean(of: Mean) -> float:
    """Return the p-value of the hypothesis that the true mean square is within ``TOLERANCE`` of 1, two-sided."""
    if of.runs < 2 or 1.0 / (1.0 + TOLERANCE) <= of.value <= 1.0 + TOLERANCE:
        return 1.0
    limit = 1.0 + TOLERANCE if of.value > 1.0 else 1.0 / (1.0 + TOLERANCE)
    v = 2.0 / (9.0 * of.nu)
    z = ((of.value / limit) ** (1.0 / 3.0) - (1.0 - v)) / np.sqrt(v)
    return min(1.0, 2.0 * float(student.sf(abs(z), of.runs - 1)))


def p_of_share(share: float, draws: float) -> float:
    """Return the p-value of the hypothesis that the true share is at least ``MIN_SHARE``, from independent draws."""
    return float(binom.cdf(round(share * draws), round(draws), MIN_SHARE))


def p_of_ratio(ratio: float, limit: float, dof: int) -> float:
    """Return the p-value of the hypothesis that the true ratio of two rms values is at most ``limit``."""
    return float(chi2.sf(dof * (ratio / limit) ** 2, dof))


def holm(p: Sequence[float]) -> Array:
    """Return the p-values adjusted for all of them together (Holm 1979)."""
    values = np.array(p, dtype=np.float64)
    order = np.argsort(values)
    adjusted = np.empty_like(values)
    adjusted[order] = np.maximum.accumulate(values[order] * (len(values) - np.arange(len(values))))
    return np.minimum(adjusted, 1.0)


def judge(tests: Sequence[tuple[str, float, str, float]]) -> list[Hypothesis]:
    """Judge hypotheses together, each given as name, observed value, limit and p-value."""
    adjusted = holm([p for *_, p in tests]).tolist()
    return [
        Hypothesis(name=name, observed=observed, limit=limit, p=p, rejected=p < LEVEL)
        for (name, observed, limit, _), p in zip(tests, adjusted, strict=True)
    ]
