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

from typing import NamedTuple

import numpy as np

from ltv_mpc.compiled import kernel
from ltv_mpc.signals import Array
from ltv_mpc.vehicle.dynamics import coefficients, derivative, heave_acceleration
from ltv_mpc.vehicle.flow import lag_weights
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle
from ltv_mpc.vehicle.thruster import revolutions, thrust
from sim.water.column import gradient_at, velocity_at


class Body(NamedTuple):
    """The true vehicle, as compiled code reads it."""

    p: Coefficients
    propellers: Array  # (3, 3): diameter (m), n_max (rev/s), lag (s) of each
    rho: float  # kg/m3
    factor: float  # true thrust over that of eq 8


def pack(vehicle: Vehicle, p: Coefficients, factor: float = 1.0) -> Array:
    """The flat array that ``body`` takes apart: a tuple's every field costs a call from Python 0.3 us. ``p`` and
    ``factor`` are the true ones.
    """
    propellers = [[t.propeller_diameter_m, t.max_rps, t.lag_s] for t in vehicle.thrusters]
    return np.concatenate([p, np.ravel(propellers), [vehicle.water_density_kgpm3, factor]])


@kernel
def body(flat: Array) -> Body:
    """The inverse of ``pack``."""
    return Body(coefficients(flat), flat[19:28].reshape(3, 3), flat[28], flat[29])


@kernel
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
    propellers, rho = true.propellers, true.rho
    # n at the start, the middle and the end of the step, shape (3, 3)
    revs = np.empty((3, 3))
    for i in range(3):
        d, n_max, lag = propellers[i, 0], propellers[i, 1], propellers[i, 2]
        inflow = s[2] if i < 2 else s[7]
        a = min(max(revolutions(y0[i], inflow, rho, d), -n_max), n_max)
        b = min(max(revolutions(y1[i], inflow, rho, d), -n_max), n_max)
        for j in range(3):
            # n(t) = w n(0) + w0 n_c(0) + w1 n_c(h)
            w, w0, w1 = lag_weights(0.5 * j * h, h, lag)
            revs[j, i] = w * n[i] + w0 * a + w1 * b
    k1, k2, k3, k4 = np.empty(8), np.empty(8), np.empty(8), np.empty(8)
    _slope(true, s, revs[0], held, depths, earlier, later, share, k1)
    _slope(true, s + 0.5 * h * k1, revs[1], held, depths, earlier, later, share, k2)
    _slope(true, s + 0.5 * h * k2, revs[1], held, depths, earlier, later, share, k3)
    _slope(true, s + h * k3, revs[2], held, depths, earlier, later, share, k4)
    for i in range(8):
        s[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    if s[6] < 0.0:
        s[6] = 0.0
        s[7] = max(s[7], 0.0)
    for i in range(3):
        n[i] = revs[2, i]
        F[i] = thrust(n[i], s[2] if i < 2 else s[7], rho, propellers[i, 0])


@kernel
def _slope(
    true: Body,
    s: Array,
    n: Array,
    held: bool,
    depths: Array,
    earlier: Array,
    later: Array,
    share: float,
    ds: Array,
) -> None:
    """ds = s' (8,), written in place."""
    z, w = s[6], s[7]
    F = np.empty(3)
    for i in range(3):
        F[i] = true.factor * thrust(n[i], s[2] if i < 2 else w, true.rho, true.propellers[i, 0])
    c, cr = np.empty(2), np.empty(2)
    c[0], c[1] = velocity_at(z, depths, earlier, later, share)
    # c' = dc/dz w: the water's change as the vehicle sinks through it
    shear = gradient_at(z, depths, earlier, later, share)
    cr[0], cr[1] = shear[0] * w, shear[1] * w
    derivative(s[:6], F[:2], c, cr, true.p, ds[:6])
    ds[6] = w
    ds[7] = heave_acceleration(w, F[2], true.p)
    if held or (z <= 0.0 and w <= 0.0 and ds[7] < 0.0):
        ds[6] = 0.0
        ds[7] = 0.0


@kernel
def drive(
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
