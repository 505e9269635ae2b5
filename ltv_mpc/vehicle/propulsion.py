"""Fixed-pitch propellers: thrust from revolutions and inflow, the inverse, and mechanical power at the shafts.

    F = a |n| n - b v_T |n|,   a = 0.4 rho d^4,   b = (1/3) rho d^3
    P = 2 pi n Q,   Q = K_Q0 rho d^5 |n| n - K_Q1 rho d^4 v_T |n|

n revolutions per second, v_T inflow (m/s, surge for the stern thrusters, heave for the vertical one), d diameter (m).
K_Q0 and K_Q1 are ``torque_coefficient`` and ``torque_inflow_coefficient`` of the vehicle file: the torque coefficient
of an open-water curve is K_Q = K_Q0 - K_Q1 J, with the advance ratio J = v_T / (n d). A propeller that the water drives
counts as P = 0: a drive feeds nothing back. Losses of motor and gearbox are not included.

Where the coefficients are missing, the relative power serves: at rest in the water P grows as |F|^1.5.
Source: Medagoda & Williams 2012, eq 8: the standard bilinear form, zero thrust at an advance ratio of 1.2.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Thruster, Vehicle

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
    # with m = |n| and the sign s of n and F: a m^2 - s b m - |F| = 0 has one positive root
    s = math.copysign(1.0, F)
    return s * (s * b + math.sqrt(b * b + 4.0 * a * abs(F))) / (2.0 * a)


def shaft_power_W(thrust_N: Array, inflow_mps: Array, thruster: Thruster, water_density_kgpm3: float) -> Array:
    """Return the mechanical power at the shaft of one propeller.

    Parameters
    ----------
    thrust_N : (M,) delivered thrust (N).
    inflow_mps : (M,) v_T, surge speed for the stern thrusters, heave speed for the vertical one (m/s).
    thruster : diameter and torque coefficients; both are set.
    water_density_kgpm3 : density (kg/m3).

    Returns
    -------
    (M,) power (W), never negative.
    """
    assert thruster.torque_coefficient is not None
    assert thruster.torque_inflow_coefficient is not None
    rho, d = water_density_kgpm3, thruster.propeller_diameter_m
    n = np.vectorize(revolutions, otypes=[np.float64])(thrust_N, inflow_mps, rho, d)
    # Q = K_Q0 rho d^5 |n| n - K_Q1 rho d^4 v_T |n|
    K_Q0, K_Q1 = thruster.torque_coefficient, thruster.torque_inflow_coefficient
    torque_Nm = (K_Q0 * rho * d**5 * n - K_Q1 * rho * d**4 * inflow_mps) * np.abs(n)
    power: Array = np.maximum(2.0 * np.pi * n * torque_Nm, 0.0)
    return power


def propulsive_power_W(vehicle: Vehicle, thrust_N: Array, surge_mps: Array, heave_mps: Array) -> Array | None:
    """Return the mechanical power at each shaft of a vehicle.

    Parameters
    ----------
    vehicle : its thrusters and its water.
    thrust_N : (M, 3) delivered thrust of port, starboard and vertical thruster (N).
    surge_mps, heave_mps : (M,) velocity through the water, ahead and down (m/s).

    Returns
    -------
    (M, 3) power (W); zero for a thruster that the vehicle does not have. None if the file has no torque coefficients.
    """
    fitted = [vehicle.thruster.port, vehicle.thruster.starboard]
    if vehicle.thruster.vertical is not None:
        fitted.append(vehicle.thruster.vertical)
    if any(thruster.torque_coefficient is None for thruster in fitted):
        return None
    power = np.zeros((len(thrust_N), 3))
    for i, (thruster, inflow) in enumerate(zip(fitted, (surge_mps, surge_mps, heave_mps), strict=False)):
        power[:, i] = shaft_power_W(thrust_N[:, i], inflow, thruster, vehicle.water_density_kgpm3)
    return power


def relative_power(vehicle: Vehicle, lateral_N: Array) -> Array:
    """Return the relative power of the lateral thrusters: sum |F|^1.5 over that of both at their largest thrust.

    Parameters
    ----------
    vehicle : its lateral thrusters.
    lateral_N : (M, 2) thrust of port and starboard (N).

    Returns
    -------
    (M,) dimensionless, 0 to 1.
    """
    full = [max(t.max_N, -t.min_N) for t in vehicle.thrusters[:2]]
    relative: Array = (np.abs(lateral_N) ** 1.5).sum(axis=1) / (np.array(full) ** 1.5).sum()
    return relative
