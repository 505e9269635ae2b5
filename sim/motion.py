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

import numpy as np

from ltv_mpc.compiled import kernel
from ltv_mpc.signals import Array
from ltv_mpc.vehicle.dynamics import derivative, heave_acceleration
from ltv_mpc.vehicle.flow import lag_weights
from ltv_mpc.vehicle.parameters import Coefficients
from ltv_mpc.vehicle.thruster import revolutions, thrust
from sim.water.column import gradient_at, velocity_at


@kernel
def step(
    s: Array,
    n: Array,
    y0: Array,
    y1: Array,
    held: bool,
    h: float,
    depths: Array,
    earlier: Array,
    later: Array,
    share: float,
    p: Coefficients,
    propellers: Array,
    rho: float,
    factor: float,
    F: Array,
) -> None:
    """``s`` (8,) and ``n`` (3,) go on by h seconds in place; ``F`` (3,) becomes the thrust eq 8 gives for n at the end.

    ``propellers`` (3, 3): diameter (m), n_max (rev/s), lag (s) of each. ``held`` keeps depth and sinking speed.
    ``factor`` is true thrust over that of eq 8.
    """
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
    _slope(s, revs[0], held, depths, earlier, later, share, p, propellers, rho, factor, k1)
    _slope(s + 0.5 * h * k1, revs[1], held, depths, earlier, later, share, p, propellers, rho, factor, k2)
    _slope(s + 0.5 * h * k2, revs[1], held, depths, earlier, later, share, p, propellers, rho, factor, k3)
    _slope(s + h * k3, revs[2], held, depths, earlier, later, share, p, propellers, rho, factor, k4)
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
    s: Array,
    n: Array,
    held: bool,
    depths: Array,
    earlier: Array,
    later: Array,
    share: float,
    p: Coefficients,
    propellers: Array,
    rho: float,
    factor: float,
    ds: Array,
) -> None:
    """ds = s' (8,), written in place."""
    z, w = s[6], s[7]
    F = np.empty(3)
    for i in range(3):
        F[i] = factor * thrust(n[i], s[2] if i < 2 else w, rho, propellers[i, 0])
    c, cr = np.empty(2), np.empty(2)
    c[0], c[1] = velocity_at(z, depths, earlier, later, share)
    # c' = dc/dz w: the water's change as the vehicle sinks through it
    shear = gradient_at(z, depths, earlier, later, share)
    cr[0], cr[1] = shear[0] * w, shear[1] * w
    derivative(s[:6], F[:2], c, cr, p, ds[:6])
    ds[6] = w
    ds[7] = heave_acceleration(w, F[2], p)
    if held or (z <= 0.0 and w <= 0.0 and ds[7] < 0.0):
        ds[6] = 0.0
        ds[7] = 0.0


@kernel
def drive(
    t: Array,
    u: Array,
    state: Array,
    revolutions: Array,
    depths: Array,
    earlier: Array,
    later: Array,
    share: float,
    p: Coefficients,
    propellers: Array,
    rho: float,
    factor: float,
    F: Array,
) -> Array:
    """``step`` from t[k] to t[k+1] (s) under commands u (M+1, 3), in place; afloat up to t = 0.

    Positions (M, 2), north and east, after each.
    """
    out = np.empty((len(t) - 1, 2))
    for k in range(len(t) - 1):
        step(
            state,
            revolutions,
            u[k],
            u[k + 1],
            t[k + 1] <= 0.0,
            t[k + 1] - t[k],
            depths,
            earlier,
            later,
            share,
            p,
            propellers,
            rho,
            factor,
            F,
        )
        out[k] = state[:2]
    return out
