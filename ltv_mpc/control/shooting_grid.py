"""Shooting grid: the knots of a horizon t (N+1,), in first stages, with t[0] = 0 and t[1] = 1.

A plan is renewed every stage, so its far end only needs to show where the near end leads. Stages that grow look far
ahead with few of them. The first half have the length of the first stage; each later one is longer than the one before
by a common factor q, such that all together reach the horizon T:

    g_k = 1 for k <= N // 2,   g_k = q^(k - N // 2) beyond,   g_1 + .. + g_N = T,   t_k = g_1 + .. + g_k

The cost is a sum over stages that approximates an integral. So the weights of a stage (position, thrust) are
proportional to its length g, that of a change of thrust to 1 / g, and the change that the slew limit allows to g.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array


def knots(stages: int, horizon: float) -> Array:
    """Return the knots of a horizon; equidistant if ``horizon`` is not larger than ``stages``.

    Parameters
    ----------
    stages : N.
    horizon : T in first stages, at least N.

    Returns
    -------
    t (N+1,) in first stages.
    """
    near = stages // 2
    far = np.arange(1.0, stages - near + 1)
    lengths = np.ones(stages)
    if horizon > stages:
        missing, step = horizon - near, 1.0
        q = missing ** (1.0 / far[-1])  # too large, so that the steps of Newton's method come down to the root
        while step > 1e-14 * q:
            step = (np.sum(q**far) - missing) / np.sum(far * q ** (far - 1.0))
            q -= step
        lengths[near:] = q**far
    return np.concatenate([[0.0], np.cumsum(lengths)])


@jit
def shift(values: Array, t: Array, stages: float) -> None:
    """Shift values at the knots to knots that lie later; the last values are held.

    Parameters
    ----------
    values : (N+1, M) a row for each of the knots, linear between them; overwritten.
    t : (N+1,) knots in first stages.
    stages : by how many first stages the new knots lie later; NaN: the values become zero.
    """
    low, last, old = 0, len(t) - 2, values.copy()
    for k in range(len(t)):
        at = t[k] + stages
        while low < last and t[low + 1] <= at:
            low += 1
        part = min(max((at - t[low]) / (t[low + 1] - t[low]), 0.0), 1.0)
        for i in range(values.shape[1]):
            values[k, i] = 0.0 if np.isnan(stages) else (1.0 - part) * old[low, i] + part * old[low + 1, i]
