"""Exact flow of the equations of motion over one stage: discretisation with linear commands and thruster lag.

The commands u = [u1, u2] are linear in time over a stage of length h, from u(0) to u(h). Each thruster follows its
command with a first-order lag tau, in closed form (s = (u(h) - u(0)) / h):

    F(t) = u(t) - tau s + (F(0) - u(0) + tau s) exp(-t / tau),   F(t) = u(t) where tau = 0

so F(t) = a(t) F(0) + b0(t) u(0) + b1(t) u(h), and the lag adds no stiffness. The current is linear in time over the
stage, from c(0) to c(h). The state X = [n, e, u, v, psi, r, F1, F2] (8,) follows X(h) = flow(X(0), u(0), u(h)), which
is integrated by the classical Runge-Kutta method of order 4.

The kernels take each array as an argument of its own: an array in a tuple costs reference counting in the innermost
loop (``ltv_mpc/jit.py``).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import heave_acceleration, rates, slopes
from ltv_mpc.vehicle.parameters import Coefficients
from ltv_mpc.vehicle.sensitivity import COLUMNS, GAIN, STATE, SUM, add_slope

STATES = 8
"""Number of states: n, e, u, v, psi, r, and the two delivered lateral thrusts."""

SUBSTEP_S = 0.15
"""Longest Runge-Kutta step. The error of a stage of 0.3 s is below 1e-5 in every state (checked by a test)."""

LONG_SUBSTEP_S = 0.3
"""Longest step of a stage longer than four steps of ``SUBSTEP_S``. Only the last stages of a long horizon are that
long, and an error of 3e-4 is acceptable there.
"""


@jit
def lag_weights(t: float, h: float, tau: float) -> tuple[float, float, float]:
    """Return a, b0, b1 of F(t) = a F(0) + b0 u(0) + b1 u(h).

    Parameters
    ----------
    t : time since the start of the stage (s).
    h : length of the stage (s).
    tau : lag of the thruster (s).
    """
    if tau <= 0.0:
        return 0.0, 1.0 - t / h, t / h
    e = np.exp(-t / tau)
    # dF/du(h) = t/h - (tau/h) (1 - e);  dF/du(0) = 1 - e - dF/du(h)
    b1 = t / h - tau / h * (1.0 - e)
    return e, 1.0 - e - b1, b1


@jit
def substeps(h: float) -> int:
    """Return the number of Runge-Kutta steps of a stage of h seconds."""
    steps = int(np.ceil(h / SUBSTEP_S - 1e-9))
    return max(1, min(steps, 4), int(np.ceil(h / LONG_SUBSTEP_S - 1e-9)))


@jit
def lag_table(h: float, p: Coefficients) -> Array:
    """Return a, b0, b1 of both lateral thrusters (M, 2, 3) at the M = 2 steps + 1 Runge-Kutta instants of a stage.

    Stages of one length share the table, because its exponentials cost a third of the integration.

    Parameters
    ----------
    h : length of the stage (s).
    p : coefficients of the vehicle.
    """
    instants = 2 * substeps(h) + 1
    lag = np.empty((instants, 2, 3))
    for i in range(instants):
        t = h * i / (instants - 1)
        lag[i, 0, 0], lag[i, 0, 1], lag[i, 0, 2] = lag_weights(t, h, p.lag_port)
        lag[i, 1, 0], lag[i, 1, 1], lag[i, 1, 2] = lag_weights(t, h, p.lag_starboard)
    return lag


@jit
def delivered(lag: Array, m: int, X: Array, u0: Array, uh: Array) -> tuple[float, float]:
    """Return the delivered thrust F (N) of both lateral thrusters at instant m of a stage.

    Parameters
    ----------
    lag : (M, 2, 3) ``lag_table`` of the stage.
    m : instant, 0 .. M - 1.
    X : (8,) state at the start of the stage.
    u0, uh : (2,) commands at the start and the end (N).
    """
    return (
        lag[m, 0, 0] * X[6] + lag[m, 0, 1] * u0[0] + lag[m, 0, 2] * uh[0],
        lag[m, 1, 0] * X[7] + lag[m, 1, 1] * u0[1] + lag[m, 1, 2] * uh[1],
    )


@jit
def advance_stage(
    X: Array,
    u0: Array,
    uh: Array,
    c0: Array,
    ch: Array,
    h: float,
    p: Coefficients,
    lag: Array,
    out: Array,
    gain: Array | None = None,
    Z: Array | None = None,
) -> None:
    """Write out = flow(X, u(0), u(h)) over one stage, and on request its sensitivities.

    Parameters
    ----------
    X : (8,) state at the start.
    u0, uh : (2,) commands at the start and the end (N).
    c0, ch : (2,) current at the start and the end, north and east (m/s).
    h : length of the stage (s).
    p : coefficients of the vehicle.
    lag : ``lag_table(h, p)``, which stages of one length share.
    out : (8,) output, the state at the end.
    gain : ``thrust_gains(lag, p)`` (``sensitivity.py``), with Z.
    Z : (SCRATCH,) is overwritten with the sensitivities; None: without them.
    """
    steps = (len(lag) - 1) // 2
    d = h / steps
    crn, cre = (ch[0] - c0[0]) / h, (ch[1] - c0[1]) / h
    n, e, u, v, psi, r = X[0], X[1], X[2], X[3], X[4], X[5]
    before = -1
    F1 = F2 = 0.0
    if Z is not None:
        Z[:] = 0.0
        for i in range(4):
            Z[STATE + COLUMNS * i + i] = 1.0
    for i in range(steps):
        ku = kv = kpsi = kr = 0.0  # the slope before, along which the next one is evaluated
        sn = se = su = sv = spsi = sr = 0.0  # the weighted sum of the slopes
        for node in range(4):
            part, weight, ahead = runge_kutta(node, d)
            t = i * d + ahead
            m = 2 * i + (node + 1) // 2
            # the two slopes in the middle share an instant, and so do the end of a step and the start of the next
            if m != before:
                before = m
                F1, F2 = delivered(lag, m, X, u0, uh)
                if gain is not None and Z is not None:
                    for j in range(2 * COLUMNS):
                        Z[GAIN + j] = gain[m, j]
            un, vn, psin, rn = u + part * ku, v + part * kv, psi + part * kpsi, r + part * kr
            kn, ke, ku, kv, kpsi, kr = rates(un, vn, psin, rn, F1, F2, c0[0] + crn * t, c0[1] + cre * t, crn, cre, p)
            sn += weight * kn
            se += weight * ke
            su += weight * ku
            sv += weight * kv
            spsi += weight * kpsi
            sr += weight * kr
            if Z is not None:
                add_slope(slopes(un, vn, psin, rn, crn, cre, p), part, weight, Z)
        n, e, u, v, psi, r = n + sn, e + se, u + su, v + sv, psi + spsi, r + sr
        if Z is not None:
            for j in range(4 * COLUMNS):
                Z[STATE + j] += Z[SUM + j]
                Z[SUM + j] = 0.0
    out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7] = n, e, u, v, psi, r, F1, F2


@jit
def runge_kutta(node: int, d: float) -> tuple[float, float, float]:
    """Return for one of the four Runge-Kutta slopes: the step along the slope before it, its weight, its time (s).

    Parameters
    ----------
    node : number of the slope, 0 .. 3.
    d : length of the step (s).
    """
    if node == 0:
        return 0.0, d / 6.0, 0.0
    if node == 3:
        return d, d / 6.0, d
    return 0.5 * d, d / 3.0, 0.5 * d


@jit
def advance_heave(
    z: float, w: float, F0: float, u0: float, uh: float, h: float, p: Coefficients
) -> tuple[float, float, float]:
    """Return depth (m), sinking speed (m/s) and vertical thrust (N) after one stage.

    Parameters
    ----------
    z, w : depth (m) and sinking speed (m/s) at the start.
    F0 : delivered vertical thrust at the start (N).
    u0, uh : vertical commands at the start and the end (N), linear in between.
    h : length of the stage (s).
    p : coefficients of the vehicle.
    """
    steps = substeps(h)
    d = h / steps
    F = F0
    for i in range(steps):
        t = i * d
        a, b0, b1 = lag_weights(t, h, p.lag_vertical)
        Fa = a * F0 + b0 * u0 + b1 * uh
        a, b0, b1 = lag_weights(t + d / 2, h, p.lag_vertical)
        Fm = a * F0 + b0 * u0 + b1 * uh
        a, b0, b1 = lag_weights(t + d, h, p.lag_vertical)
        F = a * F0 + b0 * u0 + b1 * uh
        # z' = w, w' = heave_acceleration(w, F): Runge-Kutta of order 4
        k1 = heave_acceleration(w, Fa, p)
        k2 = heave_acceleration(w + d / 2 * k1, Fm, p)
        k3 = heave_acceleration(w + d / 2 * k2, Fm, p)
        k4 = heave_acceleration(w + d * k3, F, p)
        z += d * w + d * d / 6 * (k1 + k2 + k3)
        w += d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return z, w, F
