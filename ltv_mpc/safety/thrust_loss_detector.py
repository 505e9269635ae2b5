"""Thrust loss detector: likelihood ratio for a sudden loss of thrust, from the missing impulse of each cycle.

``model_monitor.py`` computes the missing impulse. Each cycle has two rows, surge and yaw, in standard deviations of
their noise e:

    z = l_1 phi_1 + l_2 phi_2 + b phi_3 + g_1 phi_4 + g_2 phi_5 + e

    phi_1, phi_2   regressors of port and starboard thrust
    phi_3          regressor of the drag
    phi_4, phi_5   regressors of moments that the model may not contain; zero if the vehicle is identified

The unknowns l_1 = c + s, l_2 = c - s and b are the constant mismatch between vehicle and model. If mass, drag and
thrust are each off by at most 10 %, and the two thrusters differ by at most ``THRUSTER_DIFFERENCE``, they are, in units
of the true mass,

    c = 1 - (1 -+ 0.1) / (1 + m),   b = (1 +- 0.1) / (1 + m) - 1,   |m| <= 0.1                  (at most c = 0.18)

A loss adds d_1, d_2 >= 0 to l_1, l_2 from some cycle among the last thirty on. The cycles before that cycle also inform
x = [c, s, b, g_1, g_2]. They count with a reduced weight, because their noise is not quite white:

    f(x, d) = |z - phi' (l + d, b, g)|^2 over the window + PAST_WEIGHT |z - phi' (l, b, g)|^2 over the cycles before
              + |(x, d)|^2 / PRIOR_SD^2
    evidence = max over windows of (min over x of f(x, 0) - min over x, d of f(x, d)) / 2       nats

This is a generalised likelihood ratio for a change. At first only the bounds of x are known; a few seconds of thrust
inform more than these bounds (docs/thrusters.md). The likelihood ratio of single cycles shows a recovery.
Source  Willsky & Jones 1976, IEEE T-AC 21(1) (the test); here the unknowns are two losses d and five mismatches x.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array, Pair

MISMATCH = 0.1
"""Largest relative error of mass, drag and thrust, in either direction, that raises no alarm."""

THRUSTER_DIFFERENCE = 0.05
"""Largest difference of the relative thrust errors of port and starboard: both thrusters are of one make."""

DISCRETISATION_MARGIN = 0.005
"""Addition to ``MISMATCH`` for the error of the trapezoidal integrals over dt."""

MAX_SIGMAS = 3.0
"""Bound on the missing impulse of one cycle, in standard deviations, beyond what mismatch explains."""

WINDOWS = (2, 3, 4, 6, 9, 14, 20, 30)
"""Lengths of the windows in cycles: a loss may have started at the start of any of them."""

PAST_WEIGHT = 0.1
"""Weight of the cycles before a window."""

MEMORY_CYCLES = 300.0
"""Cycles after which a past cycle counts by e^-1: a minute and a half at 0.3 s."""

MAX_SWEEPS, MIN_GAIN = 500, 1e-4
"""Coordinate descent: largest number of sweeps, and the decrease of f below which it stops. The problem is convex, but
port, starboard and drag may be hard to distinguish. If the minimum without a loss is found too large, the error
counts as evidence.
"""

PRIOR_SD = 0.5
"""Prior standard deviation of each unknown, so that one that the motion does not show is zero. It costs at most two
nats for each.
"""

ONE_THRUSTER_NATS = 2.0
"""Evidence by which a loss of both thrusters must exceed that of one, to be taken as the more likely."""

MAX_GAIN_NATS = 4.0
"""Largest log-likelihood ratio of one cycle for a recovery: no single cycle shows one."""

SIZE = 6
"""Number of z and its regressors."""

Row: TypeAlias = tuple[Pair, Pair, Pair, Pair, Pair, Pair, Pair]
"""One cycle: z and phi_1 .. phi_5, each for surge and yaw. The yaw entry of the last pair is 1 if the noise of the yaw
rate is new in each estimate.
"""


def _mismatch_bounds() -> tuple[Array, Array]:
    """Return the lower and upper bounds (5, K) of c, s, b, g_1, g_2 for K masses."""
    e = MISMATCH + DISCRETISATION_MARGIN
    m = np.linspace(-e, e, 5)
    low, high, one = (1.0 - e) / (1.0 + m), (1.0 + e) / (1.0 + m), np.ones_like(m)
    difference = 0.5 * THRUSTER_DIFFERENCE * one
    return np.stack([1.0 - high, -difference, low - 1.0, -one, -one]), np.stack(
        [1.0 - low, difference, high - 1.0, one, one]
    )


LOWEST, HIGHEST = _mismatch_bounds()
MIDDLE = LOWEST.shape[1] // 2
_LARGEST = np.maximum(HIGHEST, -LOWEST).max(axis=1)
_MAX_MISMATCH = np.array([_LARGEST[0] + _LARGEST[1], _LARGEST[0] + _LARGEST[1], *_LARGEST[2:]])  # of phi_1 .. phi_5

_MIX = np.array(
    [
        [1, 0, 0, 0, 0, 0],
        [0, 1, 1, 0, 0, 0],
        [0, 1, -1, 0, 0, 0],
        [0, 0, 0, 1, 0, 0],
        [0, 0, 0, 0, 1, 0],
        [0, 0, 0, 0, 0, 1],
        [0, 1, 0, 0, 0, 0],
        [0, 0, 1, 0, 0, 0],
    ],
    dtype=np.float64,
)
"""Regressors of c, s, b, g_1, g_2, d_1, d_2 (rows 1 to 7) in terms of z and the five phi (columns); row 0 is z."""


class ThrustLossDetector:
    """Window of the last cycles and the products of all cycles before it, for one vehicle."""

    def __init__(self) -> None:
        self._rows = np.empty((WINDOWS[-1], SIZE + 1, 2))  # newest first
        self._cycles = 0  # number of valid rows
        self._past = np.zeros((SIZE, SIZE))

    @property
    def products(self) -> Array | None:
        """Decayed products of the cycles that left the window while it learned, a copy; None before the first."""
        return self._past.copy() if self._past.any() else None

    def restore(self, products: Array) -> None:
        """Continue from the ``products`` (6, 6) of another detector for the same vehicle.

        Parameters
        ----------
        products : (6, 6) products of the other detector.
        """
        self._past[...] = products

    def clear_window(self) -> None:
        """Forget the cycles in the window, because the next one does not follow them."""
        self._cycles = 0

    def add(self, row: Row, *, learn: bool) -> tuple[float, float, float]:
        """Add a cycle and return the evidence (nats) and the most likely lost shares of port and starboard.

        Parameters
        ----------
        row : the cycle.
        learn : add the cycle that leaves the window to the products.
        """
        rows = self._rows
        if self._cycles == len(rows) and learn:
            accumulate(self._past, rows[-1])
        self._cycles = min(self._cycles + 1, len(rows))
        rows[1 : self._cycles] = rows[: self._cycles - 1].copy()
        rows[0] = row
        return evaluate(rows[: self._cycles], self._past)

    def recovery_gain(self, loss: Pair) -> float:
        """Return the log-likelihood ratio (nats) of the newest cycle, of no loss against a given one.

        Parameters
        ----------
        loss : lost shares of port and starboard.
        """
        return recovery_gain(self._rows[0], self._past, np.array(loss))


@jit_outlined
def _clip_row(row: Array, axis: int, explained: float, out: Array) -> None:
    """Write z and the five phi of one axis of a cycle's row (7, 2) into out (6,), with z limited.

    z exceeds what mismatch and a loss of the share ``explained`` explain by at most ``MAX_SIGMAS``: one outlier of the
    estimate is no evidence, and a lasting loss shows in several cycles.
    """
    reach = MAX_SIGMAS + explained * (abs(row[1, axis]) + abs(row[2, axis]))
    for i in range(SIZE - 1):
        out[1 + i] = row[1 + i, axis]
        reach += abs(row[1 + i, axis]) * _MAX_MISMATCH[i]
    out[0] = min(max(row[0, axis], -reach), reach)


@jit_outlined
def _add_products(y: Array, products: Array) -> None:
    """Add y y' to the products (6, 6)."""
    for i in range(SIZE):
        for j in range(SIZE):
            products[i, j] += y[i] * y[j]


@jit
def accumulate(past: Array, row: Array) -> None:
    """Add a cycle that leaves the longest window to the products of z and the five phi, in place.

    Parameters
    ----------
    past : (6, 6) products, which decay with ``MEMORY_CYCLES``.
    row : (7, 2) row of the cycle, as in ``evaluate``.
    """
    out = np.empty(SIZE)
    for i in range(SIZE):
        for j in range(SIZE):
            past[i, j] *= 1.0 - 1.0 / MEMORY_CYCLES
    for axis in range(2):
        _clip_row(row, axis, 0.0, out)
        _add_products(out, past)


@jit_outlined
def _window_products(rows: Array, past: Array, explained: float) -> tuple[Array, Array, int]:
    """Return the products (W, 6, 6) within each window, those before each, and the number of windows.

    Parameters
    ----------
    rows, past : as in ``evaluate``.
    explained : as in ``_clip_row``.
    """
    n = rows.shape[0]
    surge, yaw = np.empty((n, SIZE)), np.empty((n, SIZE))
    fresh = True
    for k in range(n):
        _clip_row(rows[k], 0, explained, surge[k])
        _clip_row(rows[k], 1, explained, yaw[k])
        fresh = fresh and rows[k, SIZE, 1] != 0.0
    if fresh:
        whiten(yaw)
    within, before = np.empty((len(WINDOWS), SIZE, SIZE)), np.empty((len(WINDOWS), SIZE, SIZE))
    total, products = past.copy(), np.zeros((SIZE, SIZE))
    for k in range(n):
        _add_products(surge[k], total)
        _add_products(yaw[k], total)
    windows = 0
    for k in range(n):
        _add_products(surge[k], products)
        _add_products(yaw[k], products)
        if k + 1 == WINDOWS[windows]:
            for i in range(SIZE):
                for j in range(SIZE):
                    within[windows, i, j], before[windows, i, j] = products[i, j], total[i, j] - products[i, j]
            windows += 1
    return within, before, windows


@jit
def evaluate(rows: Array, past: Array) -> tuple[float, float, float]:
    """Return the evidence (nats), and the most likely lost shares of the thrust of port and starboard.

    Parameters
    ----------
    rows : (n, 7, 2) cycles (``Row``), the newest first.
    past : (6, 6) products of the cycles before, by ``accumulate``.
    """
    within, before, windows = _window_products(rows, past, 0.0)
    evidence, best = 0.0, -1
    for k in range(windows):
        F = quadratic_form(within[k], before[k])
        gain = 0.5 * (smallest(F, 0.0, 0.0)[0] - smallest(F, 1.0, 1.0)[0])
        if gain > evidence:
            evidence, best = gain, k
    if best < 0:
        return 0.0, 0.0, 0.0
    within, before, windows = _window_products(rows, past, 1.0)  # a large loss is not an outlier
    F = quadratic_form(within[best], before[best])
    least, port, starboard = smallest(F, 1.0, 1.0)
    least += 2.0 * ONE_THRUSTER_NATS
    for i in range(2):
        f, l1, l2 = smallest(F, 1.0 - i, float(i))
        if f < least:
            least, port, starboard = f, l1, l2
    return evidence, port, starboard


@jit
def recovery_gain(row: Array, past: Array, loss: Array) -> float:
    """Return the log-likelihood ratio (nats) of no loss against a loss in one cycle, at most ``MAX_GAIN_NATS``.

    The mismatch is the most likely one of the cycles before the loss.

    Parameters
    ----------
    row : (7, 2) newest cycle.
    past : (6, 6) products of the cycles before the loss.
    loss : (2,) lost shares of port and starboard.
    """
    F = quadratic_form(past, np.zeros((SIZE, SIZE)))
    x, low, high, y = np.zeros(7), np.zeros(7), np.zeros(7), np.empty(SIZE)
    for i in range(5):
        low[i], high[i] = LOWEST[i, MIDDLE], HIGHEST[i, MIDDLE]
    constrained_minimum(F, low, high, x)
    gain = 0.0
    for axis in range(2):
        _clip_row(row, axis, 1.0, y)
        lost = loss[0] * y[1] + loss[1] * y[2]
        residual = y[0] - (x[0] + x[1]) * y[1] - (x[0] - x[1]) * y[2] - x[2] * y[3] - x[3] * y[4] - x[4] * y[5]
        gain += 0.5 * ((residual - lost) ** 2 - residual**2)
    return min(gain, MAX_GAIN_NATS)


@jit_outlined
def smallest(F: Array, port_max: float, starboard_max: float) -> tuple[float, float, float]:
    """Return the minimum of f over x and over d within bounds, and there the lost shares d of both thrusters.

    Parameters
    ----------
    F : (8, 8) quadratic form.
    port_max, starboard_max : upper bounds of d; the lower bounds are zero.
    """
    x, low, high = np.zeros(7), np.zeros(7), np.empty(7)
    high[5], high[6] = port_max, starboard_max
    least, port, starboard = np.inf, 0.0, 0.0
    for k in range(LOWEST.shape[1]):
        for i in range(5):
            low[i], high[i] = LOWEST[i, k], HIGHEST[i, k]
        f = constrained_minimum(F, low, high, x)
        if f < least:
            least, port, starboard = f, x[5], x[6]
    return least, port, starboard


@jit_outlined
def quadratic_form(window: Array, past: Array) -> Array:
    """Return F (8, 8) with f = [1, -x]' F [1, -x], x = [c, s, b, g_1, g_2, d_1, d_2].

    Parameters
    ----------
    window : (6, 6) products of z and the five phi within the window.
    past : (6, 6) the same before it.
    """
    F = np.zeros((8, 8))
    _add_mixed(F, window, 1.0, 8)
    _add_mixed(F, past, PAST_WEIGHT, 6)
    for i in range(1, 8):
        F[i, i] += 1.0 / (PRIOR_SD * PRIOR_SD)
    return F


@jit_outlined
def _add_mixed(F: Array, products: Array, weight: float, size: int) -> None:
    """Add weight M products M' to the first rows and columns of F, with M the first rows of ``_MIX``."""
    for i in range(size):
        for a in range(SIZE):
            if _MIX[i, a] != 0.0:
                for j in range(size):
                    for b in range(SIZE):
                        F[i, j] += weight * _MIX[i, a] * products[a, b] * _MIX[j, b]


@jit_outlined
def constrained_minimum(F: Array, low: Array, high: Array, x: Array) -> float:
    """Return the minimum of f over low <= x <= high, by coordinate descent.

    Parameters
    ----------
    F : (8, 8) quadratic form.
    low, high : (7,) bounds of c, s, b, g_1, g_2, d_1, d_2.
    x : (7,) start; overwritten with the minimiser.
    """
    for _ in range(MAX_SWEEPS):
        gained = 0.0
        for i in range(7):
            if low[i] == high[i]:
                x[i] = low[i]
                continue
            slope = F[0, 1 + i]
            for j in range(7):
                if j != i:
                    slope -= F[1 + i, 1 + j] * x[j]
            own = F[1 + i, 1 + i]
            to = min(max(slope / own, low[i]), high[i])
            gained, x[i] = gained + own * (to - x[i]) ** 2, to
        if gained < MIN_GAIN:
            break
    f = F[0, 0]
    for i in range(7):
        f -= 2.0 * F[0, 1 + i] * x[i]
        for j in range(7):
            f += F[1 + i, 1 + j] * x[i] * x[j]
    return float(f)


@jit_outlined
def whiten(y: Array) -> None:
    """Turn rows (n, m) whose noise is w_k - w_(k+1), w white, into rows with white noise of unit variance, in place.

    It applies the inverse of the Cholesky factor of the covariance, L_kk = sqrt((k + 1) / 2 k), L_k(k-1) =
    - sqrt((k - 1) / 2 k), k = 1 .. n. The first rows do not depend on the number of rows that follow.
    """
    for k in range(2, len(y) + 1):
        for j in range(y.shape[1]):
            y[k - 1, j] = (y[k - 1, j] + math.sqrt((k - 1) / (2 * k)) * y[k - 2, j]) / math.sqrt((k + 1) / (2 * k))


def warm_up() -> None:
    """Compile the kernels."""
    rows, past = np.zeros((2, SIZE + 1, 2)), np.zeros((SIZE, SIZE))
    accumulate(past, rows[1])
    evaluate(rows, past)
    recovery_gain(rows[0], past, np.zeros(2))
