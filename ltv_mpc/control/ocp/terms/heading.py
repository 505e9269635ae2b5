"""Heading: deviation from the wanted heading at each knot, the short way round.

    1/2 w g_k (psi_k - psiref_k)^2,    w = heading_per_rad2 (1/rad2); 0: the heading is free

The headings of the target are read only if w is not 0.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import Objective, stage_length
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array


@jit
def cost(X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the value along a trajectory.

    Parameters
    ----------
    X, U, C, target, o : as in ``ocp/terms``.
    """
    total, t = 0.0, o.t
    if o.heading != 0.0:
        for k in range(1, len(X)):
            off = _short_way(X[k, 4] - target[k - 1, 2])
            total += stage_length(t, k) * off * off
    return float(0.5 * o.heading * total)


@jit
def add(p: Problem, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model.

    Parameters
    ----------
    p, lin, target, o : as in ``ocp/terms``.
    """
    X, S, t = lin.X, o.state_scale[4], o.t
    if o.heading != 0.0:
        for k in range(1, len(X)):
            weight = o.heading * stage_length(t, k) * S
            p.H[k, 4, 4] += weight * S
            p.h[k, 4] += weight * _short_way(X[k, 4] - target[k - 1, 2])


@jit
def _short_way(angle: float) -> float:
    """Return the same angle between -pi and pi (rad)."""
    return float(angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi)))
