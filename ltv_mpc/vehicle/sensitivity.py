"""Sensitivities of the exact flow over a stage: the variational equation, integrated together with the motion.

X = [n, e, u, v, psi, r, F1, F2], commands and current as in ``flow.py``. With X(h) = flow(X(0), u(0), u(h)):

    A = dX(h)/dX(0) (8, 8),   B0 = dX(h)/du(0) (8, 2),   B1 = dX(h)/du(h) (8, 2)

Columns S = d[n, e, u, v, psi, r] / d[u, v, psi, r, F1(0), F2(0), u1(0), u2(0), u1(h), u2(h)] follow
    S' = df/dx S + df/dF dF/d(.),   dF/d(.) = a, b0, b1 of the lag
with the Runge-Kutta steps of the flow, so A, B0, B1 are the exact derivatives of the flow as it is computed.

This is a third of the arithmetic of a control cycle. All rows are in one flat array at constant distances: only then
the compiler can prove that they do not overlap, and it vectorises over columns (three times faster). The kernels take
each array as an argument of its own, because an array in a tuple costs reference counting (``ltv_mpc/jit.py``).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import Slopes, rates, slopes
from ltv_mpc.vehicle.flow import delivered, runge_kutta
from ltv_mpc.vehicle.parameters import Coefficients

COLUMNS = 12
"""Columns of S and two that stay zero, to fill a whole number of vector registers."""
STATE, STEP, SUM, PLACE, GAIN = 0, 4 * COLUMNS, 8 * COLUMNS, 12 * COLUMNS, 14 * COLUMNS
"""Offsets in the scratch array: S of [u, v, psi, r]; its slope; the sum of the slopes; S of [n, e]; df/dF dF/d(.)."""
SCRATCH = 16 * COLUMNS


@jit
def thrust_gains(lag: Array, p: Coefficients) -> Array:
    """Return df/dF dF/d(.) of surge and yaw rate (M, 2 COLUMNS) at the M instants of a stage.

    Parameters
    ----------
    lag : (M, 2, 3) ``lag_table`` of the stage.
    p : coefficients of the vehicle.
    """
    gain = np.zeros((len(lag), 2 * COLUMNS))
    for i in range(len(lag)):
        for a in range(3):
            port, starboard = 4 + 2 * a, 5 + 2 * a
            gain[i, port], gain[i, starboard] = lag[i, 0, a] / p.mass_surge, lag[i, 1, a] / p.mass_surge
            gain[i, COLUMNS + port] = lag[i, 0, a] * p.arm_port / p.inertia_yaw
            gain[i, COLUMNS + starboard] = -lag[i, 1, a] * p.arm_starboard / p.inertia_yaw
    return gain


@jit
def linearise_stage(
    X: Array,
    u0: Array,
    uh: Array,
    c0: Array,
    ch: Array,
    h: float,
    p: Coefficients,
    lag: Array,
    gain: Array,
    Z: Array,
    out: Array,
    A: Array,
    B0: Array,
    B1: Array,
) -> None:
    """Write the flow over one stage and its sensitivities.

    Parameters
    ----------
    X : (8,) state at the start.
    u0, uh : (2,) commands at the start and the end (N).
    c0, ch : (2,) current at the start and the end, north and east (m/s).
    h : length of the stage (s).
    p : coefficients of the vehicle.
    lag : ``lag_table(h, p)``.
    gain : ``thrust_gains(lag, p)``.
    Z : (SCRATCH,) scratch, overwritten.
    out : (8,) output, the state at the end.
    A, B0, B1 : (8, 8), (8, 2), (8, 2) outputs, the sensitivities.
    """
    steps = (len(lag) - 1) // 2
    d = h / steps
    crn, cre = (ch[0] - c0[0]) / h, (ch[1] - c0[1]) / h
    n, e, u, v, psi, r = X[0], X[1], X[2], X[3], X[4], X[5]
    Z[:] = 0.0
    for i in range(4):
        Z[STATE + COLUMNS * i + i] = 1.0
    before = -1
    F1 = F2 = 0.0
    for i in range(steps):
        ku = kv = kpsi = kr = 0.0
        sn = se = su = sv = spsi = sr = 0.0
        for node in range(4):
            part, weight, ahead = runge_kutta(node, d)
            t = i * d + ahead
            m = 2 * i + (node + 1) // 2
            # the two slopes in the middle share an instant, and so do the end of a step and the start of the next
            if m != before:
                before = m
                F1, F2 = delivered(lag, m, X, u0, uh)
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
            _slope(slopes(un, vn, psin, rn, crn, cre, p), part, weight, Z)
        n, e, u, v, psi, r = n + sn, e + se, u + su, v + sv, psi + spsi, r + sr
        for j in range(4 * COLUMNS):
            Z[STATE + j] += Z[SUM + j]
            Z[SUM + j] = 0.0
    out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7] = n, e, u, v, psi, r, F1, F2
    _read(Z, lag[2 * steps], A, B0, B1)


@jit
def _slope(f: Slopes, part: float, weight: float, Z: Array) -> None:
    """Add one slope of S with its weight, evaluated ``part`` along the one before: S' = df/dx S + df/dF dF/d(.)."""
    for j in range(COLUMNS):
        su = Z[STATE + j] + part * Z[STEP + j]
        sv = Z[STATE + COLUMNS + j] + part * Z[STEP + COLUMNS + j]
        spsi = Z[STATE + 2 * COLUMNS + j] + part * Z[STEP + 2 * COLUMNS + j]
        sr = Z[STATE + 3 * COLUMNS + j] + part * Z[STEP + 3 * COLUMNS + j]
        du = f.u_u * su + f.u_v * sv + f.u_psi * spsi + f.u_r * sr + Z[GAIN + j]
        dv = f.v_u * su + f.v_v * sv + f.v_psi * spsi + f.v_r * sr
        dr = f.r_u * su + f.r_v * sv + f.r_r * sr + Z[GAIN + COLUMNS + j]
        # [n, e]' do not depend on S of [n, e]: nothing depends on the position
        Z[PLACE + j] += weight * (f.n_u * su + f.n_v * sv + f.n_psi * spsi)
        Z[PLACE + COLUMNS + j] += weight * (f.e_u * su + f.e_v * sv + f.e_psi * spsi)
        Z[STEP + j] = du
        Z[STEP + COLUMNS + j] = dv
        Z[STEP + 2 * COLUMNS + j] = sr  # psi' = r
        Z[STEP + 3 * COLUMNS + j] = dr
        Z[SUM + j] += weight * du
        Z[SUM + COLUMNS + j] += weight * dv
        Z[SUM + 2 * COLUMNS + j] += weight * sr
        Z[SUM + 3 * COLUMNS + j] += weight * dr


@jit
def _read(Z: Array, w: Array, A: Array, B0: Array, B1: Array) -> None:
    """Write A, B0, B1 from S and the lag at the end of the stage."""
    A[:, :] = 0.0
    B0[:, :] = 0.0
    B1[:, :] = 0.0
    for i in range(6):
        row = PLACE + COLUMNS * i if i < 2 else STATE + COLUMNS * (i - 2)
        for j in range(6):
            A[i, 2 + j] = Z[row + j]
        for j in range(2):
            B0[i, j], B1[i, j] = Z[row + 6 + j], Z[row + 8 + j]
    A[0, 0] = A[1, 1] = 1.0
    for i in range(2):
        A[6 + i, 6 + i], B0[6 + i, i], B1[6 + i, i] = w[i, 0], w[i, 1], w[i, 2]
