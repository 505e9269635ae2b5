"""Fixed-pitch propeller: thrust from revolutions and inflow, and the inverse.

    F = a |n| n - b v_T |n|,   a = 0.4 rho d^4,   b = (1/3) rho d^3

n revolutions per second, v_T inflow (m/s, surge for the stern thrusters, heave for the vertical one), d diameter (m).
The limits, slew and lag of a thruster are in ``parameters.py`` (``Thruster``).
Source: Medagoda & Williams 2012, eq 8: the standard bilinear form, zero thrust at an advance ratio of 1.2.
"""

from __future__ import annotations

import math

from ltv_mpc.jit import jit

THRUST_COEFFICIENT = 0.4
INFLOW_COEFFICIENT = 1.0 / 3.0


@jit
def thrust(n: float, inflow: float, rho: float, d: float) -> float:
    """Return the thrust F (N) of a propeller.

    Parameters
    ----------
    n : revolutions per second.
    inflow : v_T (m/s).
    rho : water density (kg/m3).
    d : diameter (m).
    """
    # F = 0.4 rho d^4 |n| n - (1/3) v_T rho d^3 |n|
    return THRUST_COEFFICIENT * rho * d**4 * abs(n) * n - INFLOW_COEFFICIENT * inflow * rho * d**3 * abs(n)


@jit
def revolutions(F: float, inflow: float, rho: float, d: float) -> float:
    """Return the revolutions n (rev/s) at which ``thrust`` is F.

    There is one quadratic for each sign of n. If two n give the same F (a small F against the sign of the inflow), the
    result has the sign of F. For F = 0 the propeller stands still.

    Parameters
    ----------
    F : thrust (N).
    inflow : v_T (m/s).
    rho : water density (kg/m3).
    d : diameter (m).
    """
    a = THRUST_COEFFICIENT * rho * d**4
    b = INFLOW_COEFFICIENT * inflow * rho * d**3
    if F == 0.0:
        return 0.0
    if F > 0.0:
        # n > 0: a n^2 - b n - F = 0 has one positive root
        return (b + math.sqrt(b * b + 4.0 * a * F)) / (2.0 * a)
    # n < 0: with m = -n > 0: -a m^2 - b m - F = 0, a m^2 + b m - |F| = 0 has one positive root
    return -(-b + math.sqrt(b * b + 4.0 * a * -F)) / (2.0 * a)
