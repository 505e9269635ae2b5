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

from typing import TypeAlias

import numpy as np

from ltv_mpc.jit import jit_outlined
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


def _clipped(rows: Array, explained: float) -> Array:
    """Return z and the five phi (n, 6, 2) of cycles (n, 7, 2), with z limited.

    z exceeds what mismatch and a loss of the share ``explained`` explain by at most ``MAX_SIGMAS``: one outlier of the
    estimate is no evidence, and a lasting loss shows in several cycles.
    """
    share = _MAX_MISMATCH + explained * np.array([1.0, 1.0, 0.0, 0.0, 0.0])
    reach = MAX_SIGMAS + np.einsum("i,nia->na", share, np.abs(rows[:, 1:SIZE]))
    out: Array = rows[:, :SIZE].copy()
    out[:, 0] = np.clip(out[:, 0], -reach, reach)
    return out


def accumulate(past: Array, row: Array) -> None:
    """Add a cycle that leaves the longest window to the products of z and the five phi, in place.

    Parameters
    ----------
    past : (6, 6) products, which decay with ``MEMORY_CYCLES``.
    row : (7, 2) row of the cycle, as in ``evaluate``.
    """
    (y,) = _clipped(row[None], 0.0)
    past *= 1.0 - 1.0 / MEMORY_CYCLES
    past += y @ y.T


def _quadratic_forms(rows: Array, past: Array, explained: float) -> Array:
    """Return ``quadratic_form`` (W, 8, 8) of the windows that the cycles fill.

    Parameters
    ----------
    rows, past : as in ``evaluate``.
    explained : as in ``_clipped``.
    """
    y = _clipped(rows, explained)
    if rows[:, SIZE, 1].all():
        y[:, :, 1] = whitened(y[:, :, 1])
    products = (y @ y.transpose(0, 2, 1)).reshape(-1, SIZE * SIZE)
    within = np.tri(len(rows))[[length - 1 for length in WINDOWS if length <= len(rows)]] @ products
    return quadratic_form(within, past.ravel() + products.sum(axis=0) - within)


def evaluate(rows: Array, past: Array) -> tuple[float, float, float]:
    """Return the evidence (nats), and the most likely lost shares of the thrust of port and starboard.

    Parameters
    ----------
    rows : (n, 7, 2) cycles (``Row``), the newest first.
    past : (6, 6) products of the cycles before, by ``accumulate``.
    """
    forms = _quadratic_forms(rows, past, 0.0)
    gains = 0.5 * (smallest(forms, 0.0, 0.0) - smallest(forms, 1.0, 1.0))[:, 0]
    evidence = float(gains.max(initial=0.0))
    if not evidence > 0.0:
        return 0.0, 0.0, 0.0
    best = int(gains.argmax())
    F = _quadratic_forms(rows, past, 1.0)[best : best + 1]  # a large loss is not an outlier
    found = np.concatenate([smallest(F, 1.0, 1.0), smallest(F, 1.0, 0.0), smallest(F, 0.0, 1.0)])
    found[0, 0] += 2.0 * ONE_THRUSTER_NATS
    _, port, starboard = found[found[:, 0].argmin()].tolist()
    return evidence, port, starboard


def recovery_gain(row: Array, past: Array, loss: Array) -> float:
    """Return the log-likelihood ratio (nats) of no loss against a loss in one cycle, at most ``MAX_GAIN_NATS``.

    The mismatch is the most likely one of the cycles before the loss.

    Parameters
    ----------
    row : (7, 2) newest cycle.
    past : (6, 6) products of the cycles before the loss.
    loss : (2,) lost shares of port and starboard.
    """
    x, low, high = np.zeros((3, 7))
    low[:5], high[:5] = LOWEST[:, MIDDLE], HIGHEST[:, MIDDLE]
    constrained_minimum(quadratic_form(past.reshape(1, -1), np.zeros((1, SIZE * SIZE)))[0], low, high, x)
    ((z, *phi),) = _clipped(row[None], 1.0)
    residual = z - x[:5] @ _MIX[1:6, 1:] @ phi
    gain = 0.5 * float(np.sum((residual - loss @ phi[:2]) ** 2 - residual**2))
    return min(gain, MAX_GAIN_NATS)


@jit_outlined
def smallest(forms: Array, port_max: float, starboard_max: float) -> Array:
    """Return for each form the minimum of f over x and over d within bounds, and there the lost shares d (W, 3).

    Parameters
    ----------
    forms : (W, 8, 8) quadratic forms.
    port_max, starboard_max : upper bounds of d; the lower bounds are zero.
    """
    out = np.empty((len(forms), 3))
    for w in range(len(forms)):
        x, low, high = np.zeros(7), np.zeros(7), np.empty(7)
        high[5], high[6] = port_max, starboard_max
        out[w, 0] = np.inf
        for k in range(LOWEST.shape[1]):
            for i in range(5):
                low[i], high[i] = LOWEST[i, k], HIGHEST[i, k]
            f = constrained_minimum(forms[w], low, high, x)
            if f < out[w, 0]:
                out[w, 0], out[w, 1], out[w, 2] = f, x[5], x[6]
    return out


_WITHOUT_LOSS = _MIX * (np.arange(8.0) < 6.0)[:, None]
_OF_WINDOW, _OF_PAST = np.kron(_MIX, _MIX).T, PAST_WEIGHT * np.kron(_WITHOUT_LOSS, _WITHOUT_LOSS).T
"""Coefficients of the entries of F in the products within a window, and before it, where d does not act."""

_PRIOR = np.diag([0.0] + 7 * [1.0 / (PRIOR_SD * PRIOR_SD)])


def quadratic_form(window: Array, past: Array) -> Array:
    """Return F (W, 8, 8) with f = [1, -x]' F [1, -x], x = [c, s, b, g_1, g_2, d_1, d_2].

    Parameters
    ----------
    window : (W, 36) products (6, 6) of z and the five phi within each window.
    past : (W, 36) the same before it.
    """
    forms: Array = (window @ _OF_WINDOW + past @ _OF_PAST).reshape(-1, 8, 8) + _PRIOR
    return forms


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


def _whitening(n: int) -> Array:
    """Return the inverse (n, n) of the Cholesky factor of the covariance of w_k - w_(k+1), w white.

    L_kk = sqrt((k + 1) / 2 k), L_k(k-1) = - sqrt((k - 1) / 2 k), k = 1 .. n.
    """
    k = np.arange(1.0, n + 1.0)
    inverse: Array = np.linalg.inv(
        np.diag(np.sqrt((k + 1) / (2 * k))) - np.diag(np.sqrt((k[1:] - 1) / (2 * k[1:])), -1)
    )
    return inverse


WHITENING = _whitening(WINDOWS[-1])


def whitened(y: Array) -> Array:
    """Turn rows (n, m) whose noise is w_k - w_(k+1), w white, into rows with white noise of unit variance.

    The first rows do not depend on the number of rows that follow.
    """
    n = len(y)
    return WHITENING[:n, :n] @ y


def warm_up() -> None:
    """Compile the kernels."""
    forms = np.zeros((1, 8, 8)) + _PRIOR
    smallest(forms, 1.0, 1.0)
    constrained_minimum(forms[0], np.zeros(7), np.zeros(7), np.zeros(7))
