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
def cost(k: int, X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the value at a knot.

    Parameters
    ----------
    k, X, U, C, target, o : as in ``ocp/terms``.
    """
    if o.heading == 0.0:
        return 0.0
    off = _short_way(X[k, 4] - target[k - 1, 2])
    return float(0.5 * o.heading * stage_length(o, k) * off * off)


@jit
def add(p: Problem, k: int, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model at a knot.

    Parameters
    ----------
    p, k, lin, target, o : as in ``ocp/terms``.
    """
    if o.heading != 0.0:
        weight = o.heading * stage_length(o, k) * o.state_scale[4]
        p.H[k, 4, 4] += weight * o.state_scale[4]
        p.h[k, 4] += weight * _short_way(lin.X[k, 4] - target[k - 1, 2])


@jit
def _short_way(angle: float) -> float:
    """Return the same angle between -pi and pi (rad)."""
    return float(angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi)))
