"""Exact flow of the equations of motion over a stage, and its sensitivities.

Commands u = [u1, u2] are linear in time over a stage of length h, from u(0) to u(h). Each thruster follows its command
with a first-order lag tau, which has a closed form (s = (u(h) - u(0)) / h):

    F(t) = u(t) - tau s + (F(0) - u(0) + tau s) exp(-t / tau),   F(t) = u(t) where tau = 0

so F(t) = a(t) F(0) + b0(t) u(0) + b1(t) u(h), and the lag costs no stiffness. The current is linear in time over the
stage, from c(0) to c(h). State over a stage: X = [n, e, u, v, psi, r, F1, F2] (8,). With

    X(h) = flow(X(0), u(0), u(h)),   A = dX(h)/dX(0) (8, 8),   B0 = dX(h)/du(0) (8, 2),   B1 = dX(h)/du(h) (8, 2)

the motion is integrated by the classical Runge-Kutta method of order 4 and the sensitivities by the same method on the
variational equation, S' = df/dx S + df/dF dF/d(.): A, B0, B1 are the derivatives of the computed flow itself.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.compiled import kernel
from ltv_mpc.signals import Array
from ltv_mpc.vehicle.dynamics import derivative, heave_acceleration, jacobian, thrust_gain
from ltv_mpc.vehicle.parameters import Coefficients

STATES = 8
"""n, e, u, v, psi, r, and the two lateral thrusts as delivered."""

SUBSTEP_S = 0.1
"""Longest Runge-Kutta step: a stage is then off by less than 2e-6 in every state (a test holds it)."""


@kernel
def lag_weights(t: float, h: float, tau: float) -> tuple[float, float, float]:
    """a, b0, b1 of F(t) = a F(0) + b0 u(0) + b1 u(h)."""
    if tau <= 0.0:
        return 0.0, 1.0 - t / h, t / h
    e = np.exp(-t / tau)
    # dF/du(h) = t/h - (tau/h) (1 - e);  dF/du(0) = 1 - e - dF/du(h)
    b1 = t / h - tau / h * (1.0 - e)
    return e, 1.0 - e - b1, b1


@kernel
def substeps(h: float) -> int:
    """How many Runge-Kutta steps a stage of h seconds takes."""
    return max(1, int(np.ceil(h / SUBSTEP_S - 1e-9)))


@kernel
def advance_stage(X: Array, u0: Array, uh: Array, c0: Array, ch: Array, h: float, p: Coefficients, out: Array) -> None:
    """out = flow(X, u(0), u(h)), all of shape (8,), over h seconds; the current goes linearly from c(0) to c(h)."""
    steps = substeps(h)
    d = h / steps
    cr = (ch - c0) / h
    x = X[:6].copy()
    F = np.empty(2)
    k1, k2, k3, k4 = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    for i in range(steps):
        t = i * d
        lagged(X, u0, uh, t, h, p, F)
        derivative(x, F, c0 + cr * t, cr, p, k1)
        lagged(X, u0, uh, t + d / 2, h, p, F)
        derivative(x + d / 2 * k1, F, c0 + cr * (t + d / 2), cr, p, k2)
        derivative(x + d / 2 * k2, F, c0 + cr * (t + d / 2), cr, p, k3)
        lagged(X, u0, uh, t + d, h, p, F)
        derivative(x + d * k3, F, c0 + cr * (t + d), cr, p, k4)
        x += d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    out[:6] = x
    out[6:] = F


@kernel
def lagged(X: Array, u0: Array, uh: Array, t: float, h: float, p: Coefficients, F: Array) -> None:
    """F(t) of both lateral thrusters, shape (2,), written into ``F``."""
    a, b0, b1 = lag_weights(t, h, p.lag_port)
    F[0] = a * X[6] + b0 * u0[0] + b1 * uh[0]
    a, b0, b1 = lag_weights(t, h, p.lag_starboard)
    F[1] = a * X[7] + b0 * u0[1] + b1 * uh[1]


@kernel
def _lag_rows(t: float, h: float, p: Coefficients, W: Array) -> None:
    """W = dF(t)/d[F(0), u(0), u(h)], shape (2, 6): port columns 0, 2, 4, starboard columns 1, 3, 5."""
    W[:, :] = 0.0
    W[0, 0], W[0, 2], W[0, 4] = lag_weights(t, h, p.lag_port)
    W[1, 1], W[1, 3], W[1, 5] = lag_weights(t, h, p.lag_starboard)


@kernel
def _slope(J: Array, G: Array, W: Array, S: Array, dS: Array) -> None:
    """dS = J S + G W on the columns [u, v, psi, r | F(0), u(0), u(h)]: the variational equation, shape (6, 10)."""
    for i in range(6):
        for j in range(10):
            total = 0.0
            for k in range(2, 6):
                total += J[i, k] * S[k, j]
            if j >= 4:
                total += G[i, 0] * W[0, j - 4] + G[i, 1] * W[1, j - 4]
            dS[i, j] = total


@kernel
def linearise_stage(
    X: Array,
    u0: Array,
    uh: Array,
    c0: Array,
    ch: Array,
    h: float,
    p: Coefficients,
    out: Array,
    A: Array,
    B0: Array,
    B1: Array,
) -> None:
    """The flow over one stage (out (8,)) and its sensitivities A (8, 8), B0 (8, 2), B1 (8, 2), all written in place."""
    steps = substeps(h)
    d = h / steps
    cr = (ch - c0) / h
    x = X[:6].copy()
    # S = dx/d[u, v, psi, r, F1(0), F2(0), u1(0), u2(0), u1(h), u2(h)], shape (6, 10); positions only carry over
    S = np.zeros((6, 10))
    for i in range(4):
        S[2 + i, i] = 1.0
    F = np.empty(2)
    k1, k2, k3, k4 = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    s1, s2, s3, s4 = np.empty((6, 10)), np.empty((6, 10)), np.empty((6, 10)), np.empty((6, 10))
    J, G, W = np.empty((6, 6)), np.empty((6, 2)), np.empty((2, 6))
    thrust_gain(p, G)
    for i in range(steps):
        t = i * d
        lagged(X, u0, uh, t, h, p, F)
        _lag_rows(t, h, p, W)
        derivative(x, F, c0 + cr * t, cr, p, k1)
        jacobian(x, cr, p, J)
        _slope(J, G, W, S, s1)
        lagged(X, u0, uh, t + d / 2, h, p, F)
        _lag_rows(t + d / 2, h, p, W)
        x2 = x + d / 2 * k1
        derivative(x2, F, c0 + cr * (t + d / 2), cr, p, k2)
        jacobian(x2, cr, p, J)
        _slope(J, G, W, S + d / 2 * s1, s2)
        x3 = x + d / 2 * k2
        derivative(x3, F, c0 + cr * (t + d / 2), cr, p, k3)
        jacobian(x3, cr, p, J)
        _slope(J, G, W, S + d / 2 * s2, s3)
        lagged(X, u0, uh, t + d, h, p, F)
        _lag_rows(t + d, h, p, W)
        x4 = x + d * k3
        derivative(x4, F, c0 + cr * (t + d), cr, p, k4)
        jacobian(x4, cr, p, J)
        _slope(J, G, W, S + d * s3, s4)
        x += d / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        S += d / 6 * (s1 + 2 * s2 + 2 * s3 + s4)
    out[:6] = x
    out[6:] = F
    A[:, :] = 0.0
    A[0, 0] = 1.0
    A[1, 1] = 1.0
    A[:6, 2:6] = S[:, 0:4]
    A[:6, 6:8] = S[:, 4:6]
    B0[:6, :] = S[:, 6:8]
    B1[:6, :] = S[:, 8:10]
    # W now holds the lag at t = h
    A[6:, 6:8] = W[:, 0:2]
    B0[6:, :] = W[:, 2:4]
    B1[6:, :] = W[:, 4:6]


@kernel
def advance_heave(
    z: float, w: float, F0: float, u0: float, uh: float, h: float, p: Coefficients
) -> tuple[float, float, float]:
    """Depth, sinking speed and vertical thrust after h seconds, the command going linearly from u(0) to u(h)."""
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
