"""One step of the true vehicle: the nominal equations with what the controller does not know.

State     s = [n, e, u, v, psi, r, z, w]  as in ltv_mpc/vehicle/dynamics.py, with depth (m) and sinking speed (m/s)
Thrusters n = [n1, n2, n3]                revolutions (rev/s)
Command   y = [y1, y2, y3]                thrust asked for (N), linear in time over the step

Of its own the plant has: the water of the true column at the true depth and its shear, c' = dc/dz w; propellers that
a governor turns towards n_c = eq 8's inverse of y at the inflow of the step's start, cut to +-n_max, with a first-order
lag in n (closed form for n_c linear over the step, so that any lag is stable, also none); thrust times a factor; the
surface, which it cannot leave.
Integrated by the classical Runge-Kutta method of order 4.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Triple
from ltv_mpc.vehicle.dynamics import coefficients, heave_acceleration, rates
from ltv_mpc.vehicle.flow import lag_weights
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle
from ltv_mpc.vehicle.thruster import revolutions, thrust
from sim.water.column import gradient_at, velocity_at


class Propeller(NamedTuple):
    """One thruster, as compiled code reads it."""

    diameter: float  # m
    most: float  # rev/s
    lag: float  # s


class Body(NamedTuple):
    """The true vehicle, likewise: numbers alone, for a step of it takes less time than the making of its arrays."""

    p: Coefficients
    port: Propeller
    starboard: Propeller
    vertical: Propeller
    rho: float  # kg/m3
    factor: float  # true thrust over that of eq 8


State: TypeAlias = tuple[float, float, float, float, float, float, float, float]
"""s."""


def pack(vehicle: Vehicle, p: Coefficients, factor: float = 1.0) -> Array:
    """The flat array that ``body`` takes apart: a tuple's every field costs a call from Python 0.3 us. ``p`` and
    ``factor`` are the true ones.
    """
    propellers = [[t.propeller_diameter_m, t.max_rps, t.lag_s] for t in vehicle.thrusters]
    return np.concatenate([p, np.ravel(propellers), [vehicle.water_density_kgpm3, factor]])


@jit
def body(flat: Array) -> Body:
    """The inverse of ``pack``."""
    return Body(
        coefficients(flat),
        Propeller(flat[19], flat[20], flat[21]),
        Propeller(flat[22], flat[23], flat[24]),
        Propeller(flat[25], flat[26], flat[27]),
        flat[28],
        flat[29],
    )


@jit
def step(
    flat: Array,
    s: Array,
    n: Array,
    F: Array,
    y0: Array,
    y1: Array,
    held: bool,
    h: float,
    depths: Array,
    earlier: Array,
    later: Array,
    share: float,
) -> None:
    """``s`` (8,) and ``n`` (3,) of the packed body ``flat`` go on by h seconds in place; ``F`` (3,) becomes the thrust
    eq 8 gives for n at the end. ``held`` keeps depth and sinking speed. The water: ``WaterColumn.between``.
    """
    true = body(flat)
    x = s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7]
    port = _revolutions(true.port, true.rho, n[0], y0[0], y1[0], x[2], h)
    starboard = _revolutions(true.starboard, true.rho, n[1], y0[1], y1[1], x[2], h)
    vertical = _revolutions(true.vertical, true.rho, n[2], y0[2], y1[2], x[7], h)
    begin, middle, end = (
        (port[0], starboard[0], vertical[0]),
        (port[1], starboard[1], vertical[1]),
        (port[2], starboard[2], vertical[2]),
    )
    k1 = _slope(true, x, begin, held, depths, earlier, later, share)
    k2 = _slope(true, _along(x, k1, 0.5 * h), middle, held, depths, earlier, later, share)
    k3 = _slope(true, _along(x, k2, 0.5 * h), middle, held, depths, earlier, later, share)
    k4 = _slope(true, _along(x, k3, h), end, held, depths, earlier, later, share)
    for i in range(8):
        s[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    if s[6] < 0.0:
        s[6] = 0.0
        s[7] = max(s[7], 0.0)
    n[0], n[1], n[2] = end
    F[0], F[1], F[2] = _thrusts(true, end, s[2], s[7])


@jit
def _revolutions(of: Propeller, rho: float, n: float, y0: float, y1: float, inflow: float, h: float) -> Triple:
    """n at the start, the middle and the end of the step."""
    a = min(max(revolutions(y0, inflow, rho, of.diameter), -of.most), of.most)
    b = min(max(revolutions(y1, inflow, rho, of.diameter), -of.most), of.most)
    return _turning(of, n, a, b, 0.0, h), _turning(of, n, a, b, 0.5 * h, h), _turning(of, n, a, b, h, h)


@jit
def _turning(of: Propeller, n: float, a: float, b: float, t: float, h: float) -> float:
    """n(t) = w n(0) + w0 n_c(0) + w1 n_c(h)."""
    w, w0, w1 = lag_weights(t, h, of.lag)
    return w * n + w0 * a + w1 * b


@jit
def _along(s: State, k: State, h: float) -> State:
    """s + h k."""
    return (
        s[0] + h * k[0], s[1] + h * k[1], s[2] + h * k[2], s[3] + h * k[3],
        s[4] + h * k[4], s[5] + h * k[5], s[6] + h * k[6], s[7] + h * k[7],
    )  # fmt: skip


@jit
def _thrusts(true: Body, n: Triple, surge: float, heave: float) -> Triple:
    """What eq 8 gives."""
    return (
        thrust(n[0], surge, true.rho, true.port.diameter),
        thrust(n[1], surge, true.rho, true.starboard.diameter),
        thrust(n[2], heave, true.rho, true.vertical.diameter),
    )


@jit
def _slope(
    true: Body, s: State, n: Triple, held: bool, depths: Array, earlier: Array, later: Array, share: float
) -> State:
    """s'."""
    _, _, u, v, psi, r, z, w = s
    F1, F2, F3 = _thrusts(true, n, u, w)
    cn, ce = velocity_at(z, depths, earlier, later, share)
    # c' = dc/dz w: the water's change as the vehicle sinks through it
    shear = gradient_at(z, depths, earlier, later, share)
    north, east, surge, sway, heading, yaw = rates(
        u, v, psi, r, true.factor * F1, true.factor * F2, cn, ce, shear[0] * w, shear[1] * w, true.p
    )
    heave = heave_acceleration(w, true.factor * F3, true.p)
    if held or (z <= 0.0 and w <= 0.0 and heave < 0.0):
        return north, east, surge, sway, heading, yaw, 0.0, 0.0
    return north, east, surge, sway, heading, yaw, w, heave


@jit
def simulate(
    flat: Array,
    s: Array,
    n: Array,
    F: Array,
    t: Array,
    u: Array,
    depths: Array,
    earlier: Array,
    later: Array,
    share: float,
) -> Array:
    """``step`` from t[k] to t[k+1] (s) under commands u (M+1, 3), in place; afloat up to t = 0.

    Positions (M, 2), north and east, after each.
    """
    out = np.empty((len(t) - 1, 2))
    for k in range(len(t) - 1):
        step(flat, s, n, F, u[k], u[k + 1], t[k + 1] <= 0.0, t[k + 1] - t[k], depths, earlier, later, share)
        out[k] = s[:2]
    return out
