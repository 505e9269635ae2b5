"""Steady speed at which the damping of the hull balances a force (surge, heave) or a moment (yaw)."""

from __future__ import annotations

import math

from ltv_mpc.jit import jit

UNBRAKED_MPS, UNBRAKED_RADPS = 5.0, 5.0
"""Speeds that replace the steady speed of a hull without, or almost without, damping."""


@jit
def steady_speed(push: float, linear: float, quadratic: float) -> float:
    """Return the speed s >= 0 with push = linear s + quadratic s^2; infinity if there is no damping.

    Parameters
    ----------
    push : force (N) or moment (N m), >= 0.
    linear : linear damping (kg/s or N m s).
    quadratic : quadratic damping (kg/m or kg m2).
    """
    # this form of the root does not cancel if one of the coefficients is small
    root = linear + math.sqrt(linear * linear + 4.0 * quadratic * push)
    if root > 0.0:
        return 2.0 * push / root
    return 0.0 if quadratic > 0.0 else math.inf
