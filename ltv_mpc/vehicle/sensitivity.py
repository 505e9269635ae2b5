"""Sensitivities of the exact flow over a stage: the variational equation, integrated together with the motion.

X = [n, e, u, v, psi, r, F1, F2], commands and current as in ``flow.py``. With X(h) = flow(X(0), u(0), u(h)):

    A = dX(h)/dX(0) (8, 8),   B0 = dX(h)/du(0) (8, 2),   B1 = dX(h)/du(h) (8, 2)

Columns S = d[n, e, u, v, psi, r] / d[u, v, psi, r, F1(0), F2(0), u1(0), u2(0), u1(h), u2(h)] follow
    S' = df/dx S + df/dF dF/d(.),   dF/d(.) = a, b0, b1 of the lag
with the Runge-Kutta steps of the flow (``flow.advance_stage``), so A, B0, B1 are the exact derivatives of the flow as
it is computed.

This is a third of the arithmetic of a control cycle. All rows are in one flat array at constant distances: only then
the compiler can prove that they do not overlap, and it vectorises over columns (three times faster). The kernels take
each array as an argument of its own, because an array in a tuple costs reference counting (``ltv_mpc/jit.py``).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import Slopes
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
def add_slope(f: Slopes, part: float, weight: float, Z: Array) -> None:
    """Add one slope of S with its weight, evaluated ``part`` along the one before: S' = df/dx S + df/dF dF/d(.).

    Parameters
    ----------
    f : derivatives of the rates.
    part, weight : of the Runge-Kutta slope.
    Z : (SCRATCH,) scratch.
    """
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
def read(Z: Array, w: Array, A: Array, B0: Array, B1: Array) -> None:
    """Write A, B0, B1 from S and the lag at the end of the stage.

    Parameters
    ----------
    Z : (SCRATCH,) scratch.
    w : (2, 3) last row of ``lag_table``.
    A, B0, B1 : (8, 8), (8, 2), (8, 2) outputs.
    """
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
