"""Evidence for a loss of thrust, from the impulses that are missing at each cycle (``model_check.py``).

Each cycle has two rows, surge and yaw, in standard deviations of their noise e,

    z = l_1 phi_1 + l_2 phi_2 + b phi_3 + e        phi: what port, starboard and drag make of each unknown

l_1 = c + s, l_2 = c - s and b are what the vehicle is otherwise than its model. Mass, drag and thrust that are all off
by no more than 10 %, and two thrusters that differ by no more than ``APART`` of it, make, in units of the true mass,

    c = 1 - (1 -+ 0.1) / (1 + m),   b = (1 +- 0.1) / (1 + m) - 1,   |m| <= 0.1                  (at most c = 0.18)

and it stays as it is. A loss is d_1, d_2 >= 0 on top of l_1, l_2, since some cycle of the last thirty. So what the
cycles before those said of x = [c, s, b] counts too, by a part of its weight, for their noise is not quite white:

    f(x, d) = |z - phi' (l, b) - phi' d|^2 over the window + TRUST |z - phi' (l, b)|^2 over what was before
    evidence = max over windows of (min over x of f(x, 0) - min over x, d of f(x, d)) / 2       nats

a generalised likelihood ratio for a change. At first nothing is known of x but its bounds; a few seconds of thrust are
worth more than these (docs/faults.md).
Source  Willsky & Jones 1976, IEEE T-AC 21(1) (the test); the unknowns are two losses and a drag.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

MISMATCH = 0.1
"""Of mass, drag and thrust each, either way: no alarm for that."""

APART = 0.05
"""Two thrusters of one vehicle are of one make: what the model has wrong of them is mostly the same for both."""

EDGE = 0.005
"""And this, for what the trapezoids over dt leave out."""

MOST_SIGMAS = 3.0
"""Of one cycle's missing impulse: beyond it says no more."""

WINDOWS = (2, 3, 4, 6, 9, 14, 20, 30)
"""Cycles that are looked at together: a loss may have begun at any of them."""

TRUST = 0.1
"""Weight of what was before a window."""

REMEMBERED = 300.0
"""Cycles after which that counts by e^-1: a minute and a half at 0.3 s."""

SWEEPS, NEAR = 500, 1e-4
"""Of coordinate descent, at most, and what one must gain to go on (f): the problem is convex, but port, starboard and
drag may be hard to tell apart, and what the first of both minima lacks would be taken for evidence.
"""

TINY = 1e-12
"""In place of the product of a thruster that has done nothing."""


def _mismatches() -> tuple[Array, Array]:
    """Least and largest (5, K) of c, s, b, d_1, d_2, by K masses."""
    e = MISMATCH + EDGE
    m = np.linspace(-e, e, 5)
    least, most, none = (1.0 - e) / (1.0 + m), (1.0 + e) / (1.0 + m), np.zeros_like(m)
    apart, all_of_it = none + 0.5 * APART, none + 1.0
    return np.stack([1.0 - most, -apart, least - 1.0, none, none]), np.stack(
        [1.0 - least, apart, most - 1.0, all_of_it, all_of_it]
    )


LOWEST, HIGHEST = _mismatches()
_FARTHEST = np.maximum(HIGHEST, -LOWEST).max(axis=1)
_REACH = np.array([_FARTHEST[0] + _FARTHEST[1], _FARTHEST[0] + _FARTHEST[1], _FARTHEST[2]])  # of l_1, l_2, b

_MIX = np.array([[1, 0, 0, 0], [0, 1, 1, 0], [0, 1, -1, 0], [0, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0]], dtype=np.float64)
"""z and what goes with c, s, b, d_1, d_2, of z and the three phi."""


@jit
def _held(row: Array, axis: int, out: Array) -> None:
    """z, phi_1, phi_2, phi_3 of a cycle's row (5, 2) into out (4,); z no further than ``MOST_SIGMAS`` outside what
    mismatch can make: one wild estimate is no evidence, and what lasts comes as several.
    """
    reach = MOST_SIGMAS
    for i in range(3):
        out[1 + i] = row[1 + i, axis]
        reach += abs(row[1 + i, axis]) * _REACH[i]
    out[0] = min(max(row[0, axis], -reach), reach)


@jit
def learn(known: Array, row: Array) -> None:
    """A cycle (5, 2) that leaves the longest window, into the products (4, 4) of z and the three phi, in place."""
    out = np.empty(4)
    known *= 1.0 - 1.0 / REMEMBERED
    for axis in range(2):
        _held(row, axis, out)
        for i in range(4):
            for j in range(4):
                known[i, j] += out[i] * out[j]


@jit
def weigh(rows: Array, known: Array) -> tuple[float, float, float]:
    """Evidence (nats), and the share of their thrust that port and starboard then most likely lack.

    ``rows`` (n, 5, 2), the newest first: z, port, starboard, drag, by surge and yaw, and 1 where the noise is new in
    each estimate; ``known`` (4, 4) by ``learn``.
    """
    n = rows.shape[0]
    surge, yaw = np.empty((n, 4)), np.empty((n, 4))
    fresh = True
    for k in range(n):
        _held(rows[k], 0, surge[k])
        _held(rows[k], 1, yaw[k])
        fresh = fresh and rows[k, 4, 1] != 0.0
    if fresh:
        yaw = whitened(yaw)
    products, before = np.zeros((4, 4)), known.copy()
    for k in range(n):
        for i in range(4):
            for j in range(4):
                before[i, j] += surge[k, i] * surge[k, j] + yaw[k, i] * yaw[k, j]
    most, port, starboard = 0.0, 0.0, 0.0
    for k in range(n):
        for i in range(4):
            for j in range(4):
                now = surge[k, i] * surge[k, j] + yaw[k, i] * yaw[k, j]
                products[i, j] += now
                before[i, j] -= now
        if k + 1 in WINDOWS:
            gained, l1, l2 = _gained(products, before)
            if gained > most:
                most, port, starboard = gained, l1, l2
    return most, port, starboard


@jit
def _gained(window: Array, known: Array) -> tuple[float, float, float]:
    """Of one window: half of what a loss takes off the least f, and what is lost then, l + d."""
    x, F = np.empty(5), mixed(window, known)
    without = with_loss = np.inf
    l1 = l2 = 0.0
    for k in range(LOWEST.shape[1]):
        x[:] = 0.0
        without = min(without, least(F, LOWEST[:, k], HIGHEST[:, k], False, x))
        f = least(F, LOWEST[:, k], HIGHEST[:, k], True, x)
        if f < with_loss:
            with_loss, l1, l2 = f, x[0] + x[1] + x[3], x[0] - x[1] + x[4]
    return 0.5 * (without - with_loss), max(l1, 0.0), max(l2, 0.0)


@jit
def mixed(window: Array, known: Array) -> Array:
    """F (6, 6): f = [1, -x]' F [1, -x], x = [c, s, b, d_1, d_2], of products (4, 4) of z and the three phi."""
    F = np.zeros((6, 6))
    for i in range(6):
        for j in range(6):
            before = TRUST if i < 4 and j < 4 else 0.0
            for k in range(4):
                for m in range(4):
                    F[i, j] += _MIX[i, k] * _MIX[j, m] * (window[k, m] + before * known[k, m])
    return F


@jit
def least(F: Array, low: Array, high: Array, lost: bool, x: Array) -> float:
    """min f over low <= x <= high (5,), without a loss unless ``lost``, from x on, in place."""
    for _ in range(SWEEPS):
        gained = 0.0
        for i in range(5 if lost else 3):
            slope = F[0, 1 + i]
            for j in range(5):
                if j != i:
                    slope -= F[1 + i, 1 + j] * x[j]
            own = F[1 + i, 1 + i]
            to = min(max(slope / max(own, TINY), low[i]), high[i])
            gained, x[i] = gained + own * (to - x[i]) ** 2, to
        if gained < NEAR:
            break
    f = F[0, 0]
    for i in range(5):
        f -= 2.0 * F[0, 1 + i] * x[i]
        for j in range(5):
            f += F[1 + i, 1 + j] * x[i] * x[j]
    return float(f)


@jit
def whitened(y: Array) -> Array:
    """y (n, m) whose rows have noise w_k - w_(k+1), w white, of unit variance: by the inverse of its covariance's
    factor, L_kk = sqrt((k + 1) / 2 k), L_k(k-1) = - sqrt((k - 1) / 2 k), k = 1 .. n. The first rows do not depend on
    how many follow.
    """
    out = y.copy()
    for k in range(2, len(y) + 1):
        for j in range(y.shape[1]):
            out[k - 1, j] = (y[k - 1, j] + math.sqrt((k - 1) / (2 * k)) * out[k - 2, j]) / math.sqrt((k + 1) / (2 * k))
    return out


def warm_up() -> None:
    """Have it compiled."""
    rows, known = np.zeros((2, 5, 2)), np.zeros((4, 4))
    learn(known, rows[1])
    weigh(rows, known)
