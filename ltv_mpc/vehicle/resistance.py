"""The steady speed that a hull's resistance leaves to a push, of surge, heave or turn alike."""

from __future__ import annotations

import math

from ltv_mpc.jit import jit

UNBRAKED_MPS, UNBRAKED_RADPS = 5.0, 5.0
"""Where nothing brakes, or hardly, the speed that counts."""


@jit
def steady(push: float, linear: float, quadratic: float) -> float:
    """The speed s >= 0 at which push = linear s + quadratic s^2; infinite where nothing brakes.

    ``push`` in N or N m, ``linear`` and ``quadratic`` the coefficients that belong to it.
    """
    # the root that loses no digits where one of both is small
    root = linear + math.sqrt(linear * linear + 4.0 * quadratic * push)
    if root > 0.0:
        return 2.0 * push / root
    return 0.0 if quadratic > 0.0 else math.inf
