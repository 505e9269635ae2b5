"""Synthetic current: a bounded first-order Gauss-Markov process over depth (section IV-A of the paper).

x_k+1 = a x_k + sqrt(1 - a^2) w,  a = exp(-cell / length),  c_k = sd x_k,  north and east independent
Bound: w is drawn from the normal distribution truncated to the values that keep |x_k+1| <= bound. The result is that of
rejection sampling, with one draw a cell.
Stationarity: the truncated chain is in detailed balance with p(x) ~ phi(x) P(|a x + sqrt(1 - a^2) w| <= bound), and x_0
is drawn from p, so every depth has the same statistics.
The standard deviation is below the nominal sd: 0.982 of it for a bound of 3, 0.856 for a bound of 2 (length 8 cells).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr, ndtri

from ltv_mpc.messages import Array


def series(
    draws: np.random.Generator,
    cells: int,
    *,
    sd_mps: float,
    cell_m: float,
    correlation_length_m: float,
    bound_sd: float,
) -> Array:
    """Return one axis of the current (m/s), shape (cells,)."""
    a = math.exp(-cell_m / correlation_length_m)
    s = math.sqrt(-math.expm1(-2.0 * cell_m / correlation_length_m))
    x = np.empty(cells)
    x[0] = _stationary(draws, a, s, bound_sd)
    for k in range(1, cells):
        x[k] = _cut_normal(draws, a * x[k - 1], s, bound_sd)
    return sd_mps * x


def _cut_normal(draws: np.random.Generator, mean: float, sd: float, bound: float) -> float:
    """Return a draw of N(mean, sd^2) truncated to +-bound, by the inverse distribution function."""
    low, high = float(ndtr((-bound - mean) / sd)), float(ndtr((bound - mean) / sd))
    value = mean + sd * float(ndtri(low + (high - low) * draws.random()))
    return min(max(value, -bound), bound)


def _stationary(draws: np.random.Generator, a: float, s: float, bound: float) -> float:
    """Return a draw of the stationary distribution p: rejection sampling from the truncated normal distribution."""

    def stays(x: float) -> float:
        return float(ndtr((bound - a * x) / s) - ndtr((-bound - a * x) / s))

    while True:
        x = _cut_normal(draws, 0.0, 1.0, bound)
        if draws.random() * stays(0.0) <= stays(x):
            return x
