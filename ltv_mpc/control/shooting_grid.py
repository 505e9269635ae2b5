"""The knots of a horizon, in first stages: t (N+1,), t[0] = 0, t[1] = 1; equidistant, or further and further apart.

A plan is renewed every stage, so its far end only has to say where the near end leads to: stages that grow look far
ahead at the cost of few. The first half of them keep the first one's length, then each is longer than the one before by
one common factor q, so that together they reach the horizon T:

    g_k = 1 for k <= N // 2,   g_k = q^(k - N // 2) beyond,   g_1 + .. + g_N = T,   t_k = g_1 + .. + g_k

The cost is a sum over stages that stands for an integral: a stage's weights go with its length g (position, thrust),
that of a change of thrust with 1 / g, and what slew allows with g.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array


def knots(stages: int, horizon: float) -> Array:
    """t (N+1,) of so many stages that reach ``horizon``, which is at least their number: equidistant where it is."""
    near = stages // 2
    far = np.arange(1.0, stages - near + 1)
    lengths = np.ones(stages)
    if horizon > stages:
        missing = horizon - near
        q = brentq(lambda q: np.sum(q**far) - missing, 1.0, missing)
        lengths[near:] = q**far
    return np.concatenate([[0.0], np.cumsum(lengths)])


@jit
def shift(values: Array, t: Array, stages: float) -> None:
    """values (N, M), a row for each knot t[1] .. t[N], become those of knots so many first stages later: linear between
    knots, the last ones kept.
    """
    N, low, old = values.shape[0], 0, values.copy()
    if N == 1:
        return
    for k in range(N):
        low, part = locate(t[1:], t[k + 1] + stages, low)
        high = min(low + 1, N - 1)
        for i in range(values.shape[1]):
            values[k, i] = (1.0 - part) * old[low, i] + part * old[high, i]


@jit
def locate(t: Array, at: float, near: int) -> tuple[int, float]:
    """Stage k and part of it in which ``at`` lies, held within t (N+1,); ``near`` is a stage at or before it."""
    last = len(t) - 2
    k = near
    while k < last and t[k + 1] <= at:
        k += 1
    return k, min(max((at - t[k]) / (t[k + 1] - t[k]), 0.0), 1.0)
