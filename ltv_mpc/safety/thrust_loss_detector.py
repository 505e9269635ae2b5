"""Thrust loss detector: likelihood ratio for a sudden loss of thrust, from the missing impulse of each cycle.

``model_monitor.py`` computes the missing impulse. Each cycle has two rows, surge and yaw, in standard deviations of
their noise e:

    z = l_1 phi_1 + l_2 phi_2 + b phi_3 + g_1 phi_4 + g_2 phi_5 + e

    phi_1, phi_2   regressors of port and starboard thrust
    phi_3          regressor of the drag
    phi_4, phi_5   regressors of moments that the model may not contain; zero if the vehicle is identified

The unknowns l_1 = c + s, l_2 = c - s and b are the constant mismatch between vehicle and model. To first order, with
the relative errors m of the mass, t of the thrust and q of the drag, they are

    c = m - t,   b = q - m

A loss adds d_1, d_2 from 0 to 1 to l_1, l_2 from some cycle among the last thirty on. The cycles before that cycle also
inform x = [c, s, b, g_1, g_2]. They count with a reduced weight, because their noise is not quite white:

    f(x, d) = |z - phi' (l + d, b, g)|^2 over the window + PAST_WEIGHT |z - phi' (l, b, g)|^2 over the cycles before
              + x' P^-1 x + |d|^2 / PRIOR_SD^2
    evidence = max over windows of (min over x of f(x, 0) - min over x, d of f(x, d)) / 2       nats

This is a generalised likelihood ratio for a change, with the prior covariance P of the mismatch. A few seconds of
thrust inform more than P (docs/thrusters.md). The likelihood ratio of single cycles shows a recovery.
Source  Willsky & Jones 1976, IEEE T-AC 21(1) (the test); here the unknowns are two losses d and five mismatches x.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ltv_mpc.messages import Array, Pair

MISMATCH_SD = 0.05
"""Prior standard deviation of the relative errors of mass, drag and thrust: errors of 10 % raise no alarm."""

MIN_LOSS = 0.1
"""Smallest share that counts as lost. The model's error is as large, and it seems to change with the current's."""

DIFFERENCE_SD = 0.02
"""Prior standard deviation of s, half of the difference of the thrust errors: both thrusters are of one make."""

MAX_SIGMAS = 3.0
"""Bound on the missing impulse of one cycle, in standard deviations, beyond what mismatch explains."""

WINDOWS = (2, 3, 4, 6, 9, 14, 20, 30)
"""Lengths of the windows in cycles: a loss may have started at the start of any of them."""

PAST_WEIGHT = 0.1
"""Weight of the cycles before a window."""

MEMORY_CYCLES = 300.0
"""Cycles after which a past cycle counts by e^-1: a minute and a half at 0.3 s."""

PRIOR_SD = 0.5
"""Prior standard deviation of the losses and of g_1, g_2, so that one that the motion does not show is zero."""

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


_MAX_MISMATCH = np.array([0.205, 0.205, 0.222, 1.0, 1.0])
"""Largest mismatch that is no outlier, in l_1, l_2, b, g_1, g_2: all of 10 %, and 5 % between the thrusters."""

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
        if self._cycles == len(self._rows) and learn:
            (y,) = _clipped(self._rows[-1:], 0.0)
            self._past = (1.0 - 1.0 / MEMORY_CYCLES) * self._past + y @ y.T
        self._cycles = min(self._cycles + 1, len(self._rows))
        rows = self._rows[: self._cycles]
        rows[1:] = rows[:-1].copy()
        rows[0] = row
        gains = losses(_quadratic_forms(rows, self._past, 0.0))[..., 0].max(axis=1)
        evidence = 0.5 * float(gains.max(initial=0.0))
        if not evidence > 0.0:
            return 0.0, 0.0, 0.0
        (found,) = losses(_quadratic_forms(rows, self._past, 1.0)[[gains.argmax()]])  # a large loss is not an outlier
        found[2, 0] -= 2.0 * ONE_THRUSTER_NATS
        _, port, starboard = found[found[:, 0].argmax()].tolist()
        return (evidence, port, starboard) if max(port, starboard) >= MIN_LOSS else (0.0, 0.0, 0.0)

    def recovery_gain(self, loss: Pair) -> float:
        """Return the log-likelihood ratio of the newest cycle of no loss against a given one, in nats.

        It is at most ``MAX_GAIN_NATS``. The mismatch is the most likely one of the cycles before the loss.

        Parameters
        ----------
        loss : lost shares of port and starboard.
        """
        (F,) = quadratic_form(self._past.reshape(1, -1), np.zeros((1, SIZE * SIZE)))
        x = np.linalg.solve(F[1:6, 1:6], F[1:6, 0])
        ((z, *phi),) = _clipped(self._rows[:1], 1.0)
        residual = z - x @ _MIX[1:6, 1:] @ phi
        gain = 0.5 * float(np.sum((residual - loss @ np.array(phi[:2])) ** 2 - residual**2))
        return min(gain, MAX_GAIN_NATS)


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


def _quadratic_forms(rows: Array, past: Array, explained: float) -> Array:
    """Return ``quadratic_form`` (W, 8, 8) of the windows that the cycles fill.

    Parameters
    ----------
    rows : (n, 7, 2) cycles (``Row``), the newest first.
    past : (6, 6) products of the cycles before.
    explained : as in ``_clipped``.
    """
    y = _clipped(rows, explained)
    if rows[:, SIZE, 1].all():
        y[:, :, 1] = whitened(y[:, :, 1])
    products = (y @ y.transpose(0, 2, 1)).reshape(-1, SIZE * SIZE)
    within = np.tri(len(rows))[[length - 1 for length in WINDOWS if length <= len(rows)]] @ products
    return quadratic_form(within, past.ravel() + products.sum(axis=0) - within)


def losses(forms: Array) -> Array:
    """Return how far a loss of port, of starboard and of both lowers the minimum of f, and the lost shares (W, 3, 3).

    Parameters
    ----------
    forms : (W, 8, 8) quadratic forms.
    """
    known, mismatch = np.array([0, 6, 7]), np.arange(1, 6)
    B = forms[:, mismatch][:, :, known]
    # f = [1, -d]' S [1, -d] with the most likely mismatch
    S = forms[:, known][:, :, known] - B.mT @ np.linalg.solve(forms[:, mismatch][:, :, mismatch], B)
    slope, curvature = S[:, 0, 1:], S[:, 1:, 1:]
    d = np.zeros((len(forms), 3, 2))
    d[:, (0, 1), (0, 1)] = slope / np.diagonal(curvature, axis1=1, axis2=2)
    d[:, 2] = np.linalg.solve(curvature, slope[..., None])[..., 0]
    d = np.clip(d, 0.0, 1.0)
    gains = 2.0 * np.einsum("wi,wki->wk", slope, d) - np.einsum("wki,wij,wkj->wk", d, curvature, d)
    return np.concatenate([gains[..., None], d], axis=2)


_WITHOUT_LOSS = _MIX * (np.arange(8.0) < 6.0)[:, None]
_OF_WINDOW, _OF_PAST = np.kron(_MIX, _MIX).T, PAST_WEIGHT * np.kron(_WITHOUT_LOSS, _WITHOUT_LOSS).T
"""Coefficients of the entries of F in the products within a window, and before it, where d does not act."""

_PRIOR = np.zeros((8, 8))
_PRIOR[1:, 1:] = np.diag([0.0, DIFFERENCE_SD**-2.0, 0.0, *[PRIOR_SD**-2.0] * 4])
_PRIOR[1:4:2, 1:4:2] = np.linalg.inv(MISMATCH_SD**2 * np.array([[2.0, -1.0], [-1.0, 2.0]]))  # of c and b


def quadratic_form(window: Array, past: Array) -> Array:
    """Return F (W, 8, 8) with f = [1, -x]' F [1, -x], x = [c, s, b, g_1, g_2, d_1, d_2].

    Parameters
    ----------
    window : (W, 36) products (6, 6) of z and the five phi within each window.
    past : (W, 36) the same before it.
    """
    forms: Array = (window @ _OF_WINDOW + past @ _OF_PAST).reshape(-1, 8, 8) + _PRIOR
    return forms


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
