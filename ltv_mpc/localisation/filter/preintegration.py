"""Strapdown integration of the inertial unit, and the error's transition gathered over many samples.

State   p, v (NED), R (body to world), gyro bias b_g, accelerometer bias b_a; errors as in ``state.py``.
Sample  mean angular rate w_m and specific force f_m over dt (body), Earth rate W (NED, zero where it is not sensed):
        w = w_m - b_g,  f = f_m - b_a,  R_mid = exp(-W dt/2) R1 exp(w dt/2)
        v2 = v1 + dt (R_mid f + g - 2 W x v1),  p2 = p1 + dt (v1 + v2) / 2,  R2 = exp(-W dt) R1 exp(w dt)
        b  decays as first-order Gauss-Markov, b2 = exp(-dt/tau) b1
Errors  t = W x phi1 + R_mid db_g,  phi2 = phi1 - dt t
        dv2 = dv1 - dt ((R_mid f) x (phi1 - dt/2 t) + R_mid db_a + 2 W x dv1),  dp2 = dp1 + dt (dv1 + dv2) / 2
Between two updates only Phi = Phi_k ... Phi_1 (15, 15) and Q (15, 15) are gathered; the large covariance is moved once.
Source  Lupton & Sukkarieh 2012, IEEE T-RO 28(1); Groves 2013, chapters 5 and 14 (error equations in the world frame).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ltv_mpc import so3
from ltv_mpc.frames import GRAVITY_MPS2
from ltv_mpc.jit import jit
from ltv_mpc.localisation.sensors.imu import Imu
from ltv_mpc.messages import Array, ImuSample, Triple
from ltv_mpc.so3 import Matrix3


def imu_noise(imu: Imu) -> Array:
    """What ``integrate`` reads of the unit: random walks and biases, (6,) in SI."""
    return np.array(
        [
            imu.angle_random_walk_rad_per_rts,
            imu.velocity_random_walk_mps_per_rts,
            imu.gyro_bias_sd_radps,
            imu.gyro_bias_tau_s,
            imu.accelerometer_bias_sd_mps2,
            imu.accelerometer_bias_tau_s,
        ]
    )


def sample_matrix(samples: Sequence[ImuSample]) -> Array:
    """(K, 6): angular rate (rad/s) and specific force (m/s2) of each."""
    return np.array([(*sample.angular_rate_radps, *sample.specific_force_mps2) for sample in samples])


@jit
def _transition(A: Array, C: Matrix3, a: Triple, W: Triple, dt: float, keep_g: float, keep_a: float) -> None:
    """A := Phi_k A for one sample, A is (15, m). C = R_mid, a = R_mid f, keep = exp(-dt/tau) of each bias."""
    h = 0.5 * dt
    for j in range(A.shape[1]):
        v0, v1, v2 = A[3, j], A[4, j], A[5, j]
        q0, q1, q2 = A[6, j], A[7, j], A[8, j]
        g0, g1, g2 = A[9, j], A[10, j], A[11, j]
        b0, b1, b2 = A[12, j], A[13, j], A[14, j]
        # t = W x phi1 + R_mid db_g
        t0 = W[1] * q2 - W[2] * q1 + C[0] * g0 + C[1] * g1 + C[2] * g2
        t1 = W[2] * q0 - W[0] * q2 + C[3] * g0 + C[4] * g1 + C[5] * g2
        t2 = W[0] * q1 - W[1] * q0 + C[6] * g0 + C[7] * g1 + C[8] * g2
        # R_mid db_a
        B0 = C[0] * b0 + C[1] * b1 + C[2] * b2
        B1 = C[3] * b0 + C[4] * b1 + C[5] * b2
        B2 = C[6] * b0 + C[7] * b1 + C[8] * b2
        # dv2 = dv1 - dt (a x m + R_mid db_a + 2 W x dv1), m = phi at the middle
        m0, m1, m2 = q0 - h * t0, q1 - h * t1, q2 - h * t2
        n0 = v0 - dt * (a[1] * m2 - a[2] * m1 + B0 + 2.0 * (W[1] * v2 - W[2] * v1))
        n1 = v1 - dt * (a[2] * m0 - a[0] * m2 + B1 + 2.0 * (W[2] * v0 - W[0] * v2))
        n2 = v2 - dt * (a[0] * m1 - a[1] * m0 + B2 + 2.0 * (W[0] * v1 - W[1] * v0))
        # dp2 = dp1 + dt (dv1 + dv2) / 2
        A[0, j] += h * (v0 + n0)
        A[1, j] += h * (v1 + n1)
        A[2, j] += h * (v2 + n2)
        A[3, j], A[4, j], A[5, j] = n0, n1, n2
        A[6, j], A[7, j], A[8, j] = q0 - dt * t0, q1 - dt * t1, q2 - dt * t2
        A[9, j], A[10, j], A[11, j] = keep_g * g0, keep_g * g1, keep_g * g2
        A[12, j], A[13, j], A[14, j] = keep_a * b0, keep_a * b1, keep_a * b2


@jit
def integrate(x: Array, R: Array, Phi: Array, Q: Array, measured: Array, dt: Array, noise: Array, W: Array) -> int:
    """One sample after the other, in place: x (n,) and R (3, 3) move, Phi and Q (15, 15) gather their transitions.

    ``measured`` (K, 6): mean angular rate and specific force of each, over its dt (K,) (s). How many; beyond one after
    which position and velocity are not finite, none.
    """
    earth = W[0], W[1], W[2]
    for k in range(len(dt)):
        _integrate(x, R, Phi, Q, measured[k], dt[k], noise, earth)
        if not math.isfinite(x[0] + x[2] + x[3] + x[5]):
            return k + 1
    return len(dt)


@jit
def _integrate(x: Array, R: Array, Phi: Array, Q: Array, measured: Array, dt: float, noise: Array, W: Triple) -> None:
    """One sample."""
    w = measured[0] - x[9], measured[1] - x[10], measured[2] - x[11]
    f0, f1, f2 = measured[3] - x[12], measured[4] - x[13], measured[5] - x[14]
    R1 = so3.read(R)
    C = so3.strapdown(R1, W, w, 0.5 * dt)  # R_mid
    a = (
        C[0] * f0 + C[1] * f1 + C[2] * f2,
        C[3] * f0 + C[4] * f1 + C[5] * f2,
        C[6] * f0 + C[7] * f1 + C[8] * f2,
    )
    v0, v1, v2 = x[3], x[4], x[5]
    # v2 = v1 + dt (R_mid f + g - 2 W x v1),  p2 = p1 + dt (v1 + v2) / 2
    x[3] += dt * (a[0] - 2.0 * (W[1] * v2 - W[2] * v1))
    x[4] += dt * (a[1] - 2.0 * (W[2] * v0 - W[0] * v2))
    x[5] += dt * (a[2] - 2.0 * (W[0] * v1 - W[1] * v0))
    x[5] += dt * GRAVITY_MPS2
    x[0] += 0.5 * dt * (v0 + x[3])
    x[1] += 0.5 * dt * (v1 + x[4])
    x[2] += 0.5 * dt * (v2 + x[5])
    so3.write(so3.strapdown(R1, W, w, dt), R)
    keep_g = math.exp(-dt / noise[3])
    keep_a = math.exp(-dt / noise[5])
    for i in range(3):
        x[9 + i] *= keep_g
        x[12 + i] *= keep_a

    _transition(Phi, C, a, W, dt, keep_g, keep_a)
    # Q := Phi_k Q Phi_k^T + Q_k, by rows, then by columns (Q is symmetric, so its transpose serves)
    _transition(Q, C, a, W, dt, keep_g, keep_a)
    for i in range(1, Q.shape[0]):
        for j in range(i):
            Q[i, j], Q[j, i] = Q[j, i], Q[i, j]
    _transition(Q, C, a, W, dt, keep_g, keep_a)
    s_g = noise[0] * noise[0] * dt
    s_a = noise[1] * noise[1] * dt
    d_g = noise[2] * noise[2] * (1.0 - keep_g * keep_g)
    d_a = noise[4] * noise[4] * (1.0 - keep_a * keep_a)
    for i in range(3):
        # white noise of the sample's mean: dv = dt n, dp = dt^2/2 n
        Q[i, i] += 0.25 * dt * dt * s_a
        Q[i, 3 + i] += 0.5 * dt * s_a
        Q[3 + i, i] += 0.5 * dt * s_a
        Q[3 + i, 3 + i] += s_a
        Q[6 + i, 6 + i] += s_g
        Q[9 + i, 9 + i] += d_g
        Q[12 + i, 12 + i] += d_a


@jit
def propagated_core(P: Array, Phi: Array, Q: Array) -> Array:
    """What ``propagate`` makes of the core's covariance: Phi P_cc Phi^T + Q, (15, 15), symmetric to the last bit."""
    c = Phi.shape[0]
    return _core(_forward(P, Phi, c), Phi, Q)


@jit
def _forward(P: Array, Phi: Array, n: int) -> Array:
    """Phi P_c, its first n columns, (15, n)."""
    c = Phi.shape[0]
    moved = np.zeros((c, n))
    for i in range(c):
        for a in range(c):
            f = Phi[i, a]
            if f != 0.0:
                for j in range(n):
                    moved[i, j] += f * P[a, j]
    return moved


@jit
def _core(moved: Array, Phi: Array, Q: Array) -> Array:
    """``propagated_core`` by ``moved`` = Phi P_c."""
    c = Phi.shape[0]
    out = np.empty((c, c))
    for i in range(c):
        for j in range(i, c):
            upper = lower = 0.0
            for a in range(c):
                upper += moved[i, a] * Phi[j, a]
                lower += moved[j, a] * Phi[i, a]
            out[i, j] = out[j, i] = 0.5 * (upper + lower + Q[i, j] + Q[j, i])
    return out


@jit
def propagate(P: Array, E: Array, Phi: Array, Q: Array) -> None:
    """The large covariance (n, n) over all that was gathered, in place: P_cr := Phi P_cr, P_cc := Phi P_cc Phi^T + Q.

    Likewise mean errors E (n, K), E_c := Phi E_c (``failure_signatures.py``). c: the fifteen core states, r: all
    others.
    P stays symmetric to the last bit. Gathering begins anew, Phi = I, Q = 0.
    """
    n, c = P.shape[0], Phi.shape[0]
    moved = _forward(P, Phi, n)
    core = _core(moved, Phi, Q)
    for i in range(c):
        for j in range(c):
            P[i, j] = core[i, j]
        for j in range(c, n):
            P[i, j] = moved[i, j]
    for j in range(c, n):
        for i in range(c):
            P[j, i] = moved[i, j]
    along = _forward(E, Phi, E.shape[1])
    for i in range(c):
        for j in range(E.shape[1]):
            E[i, j] = along[i, j]
        for j in range(c):
            Phi[i, j], Q[i, j] = 1.0 if i == j else 0.0, 0.0
