"""Thrust loss detector: likelihood ratio for a sudden loss of thrust, from the missing impulse of each cycle.

``model_monitor.py`` computes the missing impulse. Each cycle has two rows, surge and yaw, in standard deviations of
their noise e:

    z = l_1 phi_1 + l_2 phi_2 + b phi_3 + e        phi: regressors of port thrust, starboard thrust and drag

The unknowns l_1 = c + s, l_2 = c - s and b are the constant mismatch between vehicle and model. If mass, drag and
thrust are each off by at most 10 %, and the two thrusters differ by at most ``THRUSTER_DIFFERENCE``, they are, in units
of the true mass,

    c = 1 - (1 -+ 0.1) / (1 + m),   b = (1 +- 0.1) / (1 + m) - 1,   |m| <= 0.1                  (at most c = 0.18)

A loss adds d_1, d_2 >= 0 to l_1, l_2 from some cycle among the last thirty on. The cycles before that cycle also inform
x = [c, s, b]. They count with a reduced weight, because their noise is not quite white:

    f(x, d) = |z - phi' (l, b) - phi' d|^2 over the window + PAST_WEIGHT |z - phi' (l, b)|^2 over the cycles before
    evidence = max over windows of (min over x of f(x, 0) - min over x, d of f(x, d)) / 2       nats

This is a generalised likelihood ratio for a change. At first only the bounds of x are known; a few seconds of thrust
inform more than these bounds (docs/faults.md).
Source  Willsky & Jones 1976, IEEE T-AC 21(1) (the test); here the unknowns are two losses d and three mismatches x.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.jit import jit
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

MIN_PRODUCT = 1e-12
"""Replacement for the product of a thruster that has not been used."""


def _mismatch_bounds() -> tuple[Array, Array]:
    """Return the lower and upper bounds (5, K) of c, s, b, d_1, d_2 for K masses."""
    e = MISMATCH + DISCRETISATION_MARGIN
    m = np.linspace(-e, e, 5)
    low, high, zero = (1.0 - e) / (1.0 + m), (1.0 + e) / (1.0 + m), np.zeros_like(m)
    difference, full_loss = zero + 0.5 * THRUSTER_DIFFERENCE, zero + 1.0
    return np.stack([1.0 - high, -difference, low - 1.0, zero, zero]), np.stack(
        [1.0 - low, difference, high - 1.0, full_loss, full_loss]
    )


LOWEST, HIGHEST = _mismatch_bounds()
_LARGEST = np.maximum(HIGHEST, -LOWEST).max(axis=1)
_MAX_MISMATCH = np.array([_LARGEST[0] + _LARGEST[1], _LARGEST[0] + _LARGEST[1], _LARGEST[2]])  # of l_1, l_2, b

_MIX = np.array([[1, 0, 0, 0], [0, 1, 1, 0], [0, 1, -1, 0], [0, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0]], dtype=np.float64)
"""Regressors of c, s, b, d_1, d_2 (rows 1 to 5) in terms of z and the three phi (columns); row 0 is z."""


class ThrustLossDetector:
    """Window of the last cycles and the products of all cycles before it, for one vehicle."""

    def __init__(self) -> None:
        self._rows = np.empty((WINDOWS[-1], 5, 2))  # newest first
        self._cycles = 0  # number of valid rows
        self._past = np.zeros((4, 4))

    @property
    def products(self) -> Array | None:
        """Decayed products of the cycles that left the window while it learned, a copy; None before the first."""
        return self._past.copy() if self._past.any() else None

    def restore(self, products: Array) -> None:
        """Continue from the ``products`` (4, 4) of another detector for the same vehicle.

        Parameters
        ----------
        products : (4, 4) products of the other detector.
        """
        self._past[...] = products

    def clear_window(self) -> None:
        """Forget the cycles in the window, because the next one does not follow them."""
        self._cycles = 0

    def add(self, row: tuple[Pair, Pair, Pair, Pair, Pair], *, learn: bool) -> tuple[float, float, float]:
        """Add a cycle and return the evidence (nats) and the most likely lost shares of port and starboard.

        Parameters
        ----------
        row : z, port, starboard, drag, each for surge and yaw, and as in ``evaluate`` whether the yaw noise is fresh.
        learn : add the cycle that leaves the window to the products.
        """
        rows = self._rows
        if self._cycles == len(rows) and learn:
            accumulate(self._past, rows[-1])
        self._cycles = min(self._cycles + 1, len(rows))
        rows[1 : self._cycles] = rows[: self._cycles - 1].copy()
        rows[0] = row
        return evaluate(rows[: self._cycles], self._past)


@jit
def _clip_row(row: Array, axis: int, out: Array) -> None:
    """Write z, phi_1, phi_2, phi_3 of one axis of a cycle's row (5, 2) into out (4,), with z limited.

    z exceeds what mismatch explains by at most ``MAX_SIGMAS``: one outlier of the estimate is no evidence, and a
    lasting loss shows in several cycles.
    """
    reach = MAX_SIGMAS
    for i in range(3):
        out[1 + i] = row[1 + i, axis]
        reach += abs(row[1 + i, axis]) * _MAX_MISMATCH[i]
    out[0] = min(max(row[0, axis], -reach), reach)


@jit
def accumulate(past: Array, row: Array) -> None:
    """Add a cycle that leaves the longest window to the products of z and the three phi, in place.

    Parameters
    ----------
    past : (4, 4) products, which decay with ``MEMORY_CYCLES``.
    row : (5, 2) row of the cycle, as in ``evaluate``.
    """
    out = np.empty(4)
    past *= 1.0 - 1.0 / MEMORY_CYCLES
    for axis in range(2):
        _clip_row(row, axis, out)
        for i in range(4):
            for j in range(4):
                past[i, j] += out[i] * out[j]


@jit
def evaluate(rows: Array, past: Array) -> tuple[float, float, float]:
    """Return the evidence (nats), and the most likely lost shares of the thrust of port and starboard.

    Parameters
    ----------
    rows : (n, 5, 2) cycles, the newest first: z, port, starboard, drag, each for surge and yaw. The yaw entry of the
        last row of each is 1 if the noise of the yaw rate is new in each estimate.
    past : (4, 4) products of the cycles before, by ``accumulate``.
    """
    n = rows.shape[0]
    surge, yaw = np.empty((n, 4)), np.empty((n, 4))
    fresh = True
    for k in range(n):
        _clip_row(rows[k], 0, surge[k])
        _clip_row(rows[k], 1, yaw[k])
        fresh = fresh and rows[k, 4, 1] != 0.0
    if fresh:
        yaw = whiten(yaw)
    products, before = np.zeros((4, 4)), past.copy()
    for k in range(n):
        for i in range(4):
            for j in range(4):
                before[i, j] += surge[k, i] * surge[k, j] + yaw[k, i] * yaw[k, j]
    evidence, port, starboard = 0.0, 0.0, 0.0
    for k in range(n):
        for i in range(4):
            for j in range(4):
                now = surge[k, i] * surge[k, j] + yaw[k, i] * yaw[k, j]
                products[i, j] += now
                before[i, j] -= now
        if k + 1 in WINDOWS:
            gain, l1, l2 = _likelihood_gain(products, before)
            if gain > evidence:
                evidence, port, starboard = gain, l1, l2
    return evidence, port, starboard


@jit
def _likelihood_gain(window: Array, past: Array) -> tuple[float, float, float]:
    """Return half of the decrease of the minimum of f by a loss in one window, and the lost shares l + d."""
    x, F = np.empty(5), quadratic_form(window, past)
    without = with_loss = np.inf
    l1 = l2 = 0.0
    for k in range(LOWEST.shape[1]):
        x[:] = 0.0
        without = min(without, constrained_minimum(F, LOWEST[:, k], HIGHEST[:, k], False, x))
        f = constrained_minimum(F, LOWEST[:, k], HIGHEST[:, k], True, x)
        if f < with_loss:
            with_loss, l1, l2 = f, x[0] + x[1] + x[3], x[0] - x[1] + x[4]
    return 0.5 * (without - with_loss), max(l1, 0.0), max(l2, 0.0)


@jit
def quadratic_form(window: Array, past: Array) -> Array:
    """Return F (6, 6) with f = [1, -x]' F [1, -x], x = [c, s, b, d_1, d_2].

    Parameters
    ----------
    window : (4, 4) products of z and the three phi within the window.
    past : (4, 4) the same before it.
    """
    F = np.zeros((6, 6))
    for i in range(6):
        for j in range(6):
            before = PAST_WEIGHT if i < 4 and j < 4 else 0.0
            for k in range(4):
                for m in range(4):
                    F[i, j] += _MIX[i, k] * _MIX[j, m] * (window[k, m] + before * past[k, m])
    return F


@jit
def constrained_minimum(F: Array, low: Array, high: Array, loss: bool, x: Array) -> float:
    """Return the minimum of f over low <= x <= high, by coordinate descent.

    Parameters
    ----------
    F : (6, 6) quadratic form.
    low, high : (5,) bounds of c, s, b, d_1, d_2.
    loss : False fixes d_1 = d_2 = 0.
    x : (5,) start; overwritten with the minimiser.
    """
    for _ in range(MAX_SWEEPS):
        gained = 0.0
        for i in range(5 if loss else 3):
            slope = F[0, 1 + i]
            for j in range(5):
                if j != i:
                    slope -= F[1 + i, 1 + j] * x[j]
            own = F[1 + i, 1 + i]
            to = min(max(slope / max(own, MIN_PRODUCT), low[i]), high[i])
            gained, x[i] = gained + own * (to - x[i]) ** 2, to
        if gained < MIN_GAIN:
            break
    f = F[0, 0]
    for i in range(5):
        f -= 2.0 * F[0, 1 + i] * x[i]
        for j in range(5):
            f += F[1 + i, 1 + j] * x[i] * x[j]
    return float(f)


@jit
def whiten(y: Array) -> Array:
    """Return rows (n, m) with white noise of unit variance, given rows y whose noise is w_k - w_(k+1), w white.

    It applies the inverse of the Cholesky factor of the covariance, L_kk = sqrt((k + 1) / 2 k), L_k(k-1) =
    - sqrt((k - 1) / 2 k), k = 1 .. n. The first rows do not depend on the number of rows that follow.
    """
    out = y.copy()
    for k in range(2, len(y) + 1):
        for j in range(y.shape[1]):
            out[k - 1, j] = (y[k - 1, j] + math.sqrt((k - 1) / (2 * k)) * out[k - 2, j]) / math.sqrt((k + 1) / (2 * k))
    return out


def warm_up() -> None:
    """Compile the kernels."""
    rows, past = np.zeros((2, 5, 2)), np.zeros((4, 4))
    accumulate(past, rows[1])
    evaluate(rows, past)
