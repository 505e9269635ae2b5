"""One integration step of the true vehicle: the nominal equations plus effects that the controller does not know.

State     s = [n, e, u, v, psi, r, z, w]  as in ltv_mpc/vehicle/dynamics.py, with depth (m) and sinking speed (m/s)
Thrusters n = [n1, n2, n3]                revolutions (rev/s) of port, starboard and vertical thruster
Command   y = [y1, y2, y3]                commanded thrust (N), linear in time over the step

Effects of the true vehicle alone:
- the true water column at the true depth, and its shear, c' = dc/dz w;
- propellers with a first-order lag in n. A governor drives them to n_c, the inverse of eq 8 for y at the inflow at the
  start of the step, limited to +-n_max. The lag is solved in closed form for n_c linear over the step, so every lag
  is stable, also a lag of zero;
- true thrust: eq 8 times a factor of each thruster, within its limits min_N and max_N. Without the limits, a change of
  the inflow during the lag would make a thruster at its limit deliver more. The actuators report eq 8 without the
  factor;
- other masses, damping, arms and lags than those of the vehicle file (``Mismatch``);
- the surface, above which the vehicle cannot rise.
Integrator: the classical Runge-Kutta method of order 4.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Triple
from ltv_mpc.vehicle.dynamics import coefficients, heave_acceleration, rates
from ltv_mpc.vehicle.flow import lag_weights
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle
from ltv_mpc.vehicle.propulsion import revolutions, thrust
from sim.scenario import Mismatch
from sim.water.column import WaterSample, water_at

NO_MISMATCH = Mismatch()


class Propeller(NamedTuple):
    """Propeller of one thruster, for compiled code."""

    diameter: float  # m
    max_rps: float  # rev/s
    lag: float  # time constant, s
    min_N: float
    max_N: float


class Body(NamedTuple):
    """True vehicle, for compiled code. It holds scalars only: to allocate arrays would take longer than a step."""

    p: Coefficients
    port: Propeller
    starboard: Propeller
    vertical: Propeller
    rho: float  # density of the water, kg/m3
    factors: Triple  # true thrust over that of eq 8, by thruster


class MotionState(NamedTuple):
    """State of the true vehicle in arrays that ``step`` updates in place."""

    s: Array  # (8,) state
    n: Array  # (3,) revolutions (rev/s)
    F: Array  # (3,) thrust (N) by eq 8 for n within the limits, without the body's factors


State: TypeAlias = tuple[float, float, float, float, float, float, float, float]
"""State s as a tuple."""


def apply_mismatch(p: Coefficients, mismatch: Mismatch) -> Coefficients:
    """Return the true vehicle's coefficients.

    ``mass`` scales masses and inertia, but not the net buoyancy; ``drag`` scales damping.
    """
    factors = {name: mismatch.drag for name in p._fields if name.startswith(("linear", "quadratic"))}
    factors |= dict.fromkeys(("mass_surge", "mass_sway", "mass_heave", "inertia_yaw", "dry_mass"), mismatch.mass)
    factors |= {"arm_port": mismatch.port_arm, "arm_starboard": mismatch.starboard_arm}
    return p._replace(**{name: factor * getattr(p, name) for name, factor in factors.items()})


def pack(vehicle: Vehicle, mismatch: Mismatch = NO_MISMATCH) -> Array:
    """Return the true vehicle as the flat array that ``unpack`` reads.

    One array costs less than a tuple: a call from Python takes 0.3 us for each field of a tuple.
    """
    propellers = []
    for t, factor in zip(vehicle.thrusters, mismatch.thrusts, strict=True):
        over = max(factor, 1.0)  # the delivered thrust, which includes the factor, stays within the thruster's limits
        lag_s = t.lag_s * mismatch.lag + mismatch.extra_lag_s
        propellers += [t.propeller_diameter_m, t.max_rps, lag_s, t.min_N / over, t.max_N / over]
    p = apply_mismatch(vehicle.coefficients(), mismatch)
    return np.array([*p, *propellers, vehicle.water_density_kgpm3, *mismatch.thrusts])


@jit
def unpack(flat: Array) -> Body:
    """Return the vehicle that ``pack`` has flattened."""
    return Body(
        coefficients(flat),
        Propeller(flat[21], flat[22], flat[23], flat[24], flat[25]),
        Propeller(flat[26], flat[27], flat[28], flat[29], flat[30]),
        Propeller(flat[31], flat[32], flat[33], flat[34], flat[35]),
        flat[36],
        (flat[37], flat[38], flat[39]),
    )


@jit
def step(flat: Array, vehicle: MotionState, y0: Array, y1: Array, held: bool, h: float, water: WaterSample) -> None:
    """Integrate ``vehicle`` over h seconds, in place.

    Parameters
    ----------
    flat : the true vehicle, from ``pack``.
    vehicle : state, revolutions and thrust at the start; at the end of the step afterwards.
    y0, y1 : (3,) commanded thrust (N) at the start and at the end of the step.
    held : keep depth and sinking speed: the vehicle is afloat.
    h : length of the step (s).
    water : the water column during the step.
    """
    true, s, n, F = unpack(flat), vehicle.s, vehicle.n, vehicle.F
    x = s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7]
    port = _revolutions(true.port, true.rho, n[0], y0[0], y1[0], x[2], h)
    starboard = _revolutions(true.starboard, true.rho, n[1], y0[1], y1[1], x[2], h)
    vertical = _revolutions(true.vertical, true.rho, n[2], y0[2], y1[2], x[7], h)
    begin, middle, end = (
        (port[0], starboard[0], vertical[0]),
        (port[1], starboard[1], vertical[1]),
        (port[2], starboard[2], vertical[2]),
    )
    k1 = _slope(true, x, begin, held, water)
    k2 = _slope(true, _along(x, k1, 0.5 * h), middle, held, water)
    k3 = _slope(true, _along(x, k2, 0.5 * h), middle, held, water)
    k4 = _slope(true, _along(x, k3, h), end, held, water)
    for i in range(8):
        s[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    if s[6] < 0.0:
        s[6] = 0.0
        s[7] = max(s[7], 0.0)
    n[0], n[1], n[2] = end
    F[0], F[1], F[2] = _thrusts(true, end, s[2], s[7])


@jit
def _revolutions(propeller: Propeller, rho: float, n: float, y0: float, y1: float, inflow: float, h: float) -> Triple:
    """Return the revolutions at the start, the middle and the end: n(t) = w n(0) + w0 n_c(0) + w1 n_c(h)."""
    a = min(max(revolutions(y0, inflow, rho, propeller.diameter), -propeller.max_rps), propeller.max_rps)
    b = min(max(revolutions(y1, inflow, rho, propeller.diameter), -propeller.max_rps), propeller.max_rps)
    s, s0, s1 = lag_weights(0.0, h, propeller.lag)
    m, m0, m1 = lag_weights(0.5 * h, h, propeller.lag)
    e, e0, e1 = lag_weights(h, h, propeller.lag)
    return s * n + s0 * a + s1 * b, m * n + m0 * a + m1 * b, e * n + e0 * a + e1 * b


@jit
def _along(s: State, k: State, h: float) -> State:
    """Return s + h k."""
    return (
        s[0] + h * k[0], s[1] + h * k[1], s[2] + h * k[2], s[3] + h * k[3],
        s[4] + h * k[4], s[5] + h * k[5], s[6] + h * k[6], s[7] + h * k[7],
    )  # fmt: skip


@jit
def _thrusts(true: Body, n: Triple, surge: float, heave: float) -> Triple:
    """Return the thrust (N) of each thruster by eq 8, within its limits."""
    return (
        _limited_thrust(true.port, n[0], surge, true.rho),
        _limited_thrust(true.starboard, n[1], surge, true.rho),
        _limited_thrust(true.vertical, n[2], heave, true.rho),
    )


@jit
def _limited_thrust(propeller: Propeller, n: float, inflow: float, rho: float) -> float:
    """Return the thrust (N) at n revolutions, within the thruster's limits."""
    return min(max(thrust(n, inflow, rho, propeller.diameter), propeller.min_N), propeller.max_N)


@jit
def _slope(true: Body, s: State, n: Triple, held: bool, water: WaterSample) -> State:
    """Return the time derivative s'."""
    _, _, u, v, psi, r, z, w = s
    F1, F2, F3 = _thrusts(true, n, u, w)
    f1, f2, f3 = true.factors
    # c' = dc/dz w: the change of the water's velocity as the vehicle sinks through it
    cn, ce, shear_north, shear_east = water_at(z, water)
    north, east, surge, sway, heading, yaw = rates(
        u, v, psi, r, f1 * F1, f2 * F2, cn, ce, shear_north * w, shear_east * w, true.p
    )
    heave = heave_acceleration(w, f3 * F3, true.p)
    if held or (z <= 0.0 and w <= 0.0 and heave < 0.0):
        return north, east, surge, sway, heading, yaw, 0.0, 0.0
    return north, east, surge, sway, heading, yaw, w, heave
