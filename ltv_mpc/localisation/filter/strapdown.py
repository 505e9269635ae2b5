"""Strapdown integration of IMU samples, with the error transition accumulated over many samples.

State   p, v (NED), R (body to world), gyro bias b_g, accelerometer bias b_a (FRD); errors as in ``state.py``.
Sample  mean angular rate w_m and specific force f_m over dt (body), Earth rate W (NED, zero if not sensed):
        w = w_m - b_g,  f = f_m - b_a,  R_mid = exp(-W dt/2) R1 exp(w dt/2)
        v2 = v1 + dt (R_mid f + g - 2 W x v1),  p2 = p1 + dt (v1 + v2) / 2,  R2 = exp(-W dt) R1 exp(w dt)
        biases are first-order Gauss-Markov, b2 = exp(-dt/tau) b1
Errors  t = W x phi1 + R_mid db_g,  phi2 = phi1 - dt t
        dv2 = dv1 - dt ((R_mid f) x (phi1 - dt/2 t) + R_mid db_a + 2 W x dv1),  dp2 = dp1 + dt (dv1 + dv2) / 2
Between two updates only Phi = Phi_k ... Phi_1 and its noise Q accumulate; the full covariance is propagated once.
Shapes  x (n,) with the core states first, R (3, 3), Phi and Q (15, 15), P (n, n), E (n, K) mean errors of K hypotheses
        (``adaptive/failure_signatures.py``), noise (6,) of ``imu_noise``, W (3,).
Source  Lupton & Sukkarieh 2012, IEEE T-RO 28(1); Groves 2013, chapters 5 and 14 (error equations in the world frame).
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc import so3
from ltv_mpc.frames import GRAVITY_MPS2
from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.localisation.sensors.imu import Imu
from ltv_mpc.messages import Array, Triple
from ltv_mpc.so3 import Matrix3


def imu_noise(imu: Imu) -> Array:
    """Return the noise parameters of an IMU, (6,) in SI.

    Order: angle random walk, velocity random walk, gyro bias sd and time constant, accelerometer bias sd and time
    constant.
    """
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


@jit_outlined
def _transition(A: Array, C: Matrix3, a: Triple, W: Triple, dt: float, keep_g: float, keep_a: float) -> None:
    """Multiply A (15, m) by one sample's transition, A := Phi_k A.

    C = R_mid, a = R_mid f, keep = exp(-dt/tau) of each bias.
    """
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
def integrate(x: Array, R: Array, Phi: Array, Q: Array, measured: Array, dt: float, noise: Array, earth: Array) -> None:
    """Integrate one sample, in place, and accumulate the error transition.

    Parameters
    ----------
    x : (n,) states; the core states change.
    R : (3, 3) attitude, body to NED; changes.
    Phi : (15, 15) accumulated transition, Phi := Phi_k Phi.
    Q : (15, 15) accumulated process noise, Q := Phi_k Q Phi_k^T + Q_k.
    measured : (6,) mean angular rate (rad/s) and specific force (m/s2) of the sample, FRD.
    dt : duration (s).
    noise : (6,) of ``imu_noise``.
    earth : (3,) Earth rate (rad/s, NED); zero if the gyros do not sense it.
    """
    W = earth[0], earth[1], earth[2]
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


def propagated_core(P: Array, Phi: Array, Q: Array) -> Array:
    """Return the propagated covariance of the core states, Phi P_cc Phi^T + Q, bitwise symmetric.

    Parameters
    ----------
    P : (n, n) covariance before propagation; it does not change.
    Phi : (15, 15) accumulated transition.
    Q : (15, 15) accumulated process noise.

    Returns
    -------
    (15, 15), the core block that ``propagate`` would write.
    """
    c = len(Phi)
    core = Phi @ P[:c, :c] @ Phi.T + Q
    return 0.5 * (core + core.T)


def propagate(P: Array, E: Array, Phi: Array, Q: Array) -> None:
    """Propagate the full covariance over the accumulated samples, in place, and reset Phi := I, Q := 0.

        P_cr := Phi P_cr,  P_cc := Phi P_cc Phi^T + Q,  E_c := Phi E_c      c: the core states, r: all others

    P stays bitwise symmetric.

    Parameters
    ----------
    P : (n, n) covariance; changes.
    E : (n, K) mean errors of K fault hypotheses; changes.
    Phi : (15, 15) accumulated transition; reset.
    Q : (15, 15) accumulated process noise; reset.
    """
    c = len(Phi)
    core, cross = propagated_core(P, Phi, Q), Phi @ P[:c, c:]
    P[:c, :c], P[:c, c:], P[c:, :c] = core, cross, cross.T
    E[:c] = Phi @ E[:c]
    Phi[:], Q[:] = np.eye(c), 0.0
