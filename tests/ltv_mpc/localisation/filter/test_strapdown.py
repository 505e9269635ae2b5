"""Strapdown integration against a fine integration of the continuous equations; transition against differences."""

import numpy as np
from scipy.integrate import quad_vec, solve_ivp

from ltv_mpc.frames import earth_rate, rotation, rotation_exp, rotation_log
from ltv_mpc.localisation.filter.strapdown import imu_noise, integrate, propagate
from ltv_mpc.localisation.sensor_config import SensorConfig

IMU = SensorConfig.load("realistic").imu
NOISE = imu_noise(IMU)
DT = 0.01
FAST_EARTH = 100 * earth_rate(-0.6) + np.array([0, 3e-3, 0])  # every term counts, none drowns in the others
RATE = np.array([0.3, -0.2, 0.5])
FORCE = np.array([0.4, -0.7, -9.5])


def rate(t):
    return np.array([0.1 * np.cos(1.5 * t), 0.15 * np.sin(1.2 * t), 0.2 + 0.1 * np.sin(t)])


def force(t):
    return np.array([0.3 * np.sin(t), 0.2 * np.cos(0.7 * t), -9.8 + 0.1 * np.sin(2 * t)])


def start(seed=0):
    rng = np.random.default_rng(seed)
    x = np.zeros(15)
    x[3:6] = rng.standard_normal(3)
    x[9:12] = 0.01 * rng.standard_normal(3)
    x[12:15] = 0.1 * rng.standard_normal(3)
    return x, rotation(0.2, -0.3, 2.5)


def run(x, R, rates, forces, earth=FAST_EARTH, noise=NOISE, dt=DT):
    Phi, Q = np.eye(15), np.zeros((15, 15))
    for measured in np.hstack([rates, forces]):
        integrate(x, R, Phi, Q, measured, dt, noise, earth)
    return Phi, Q


def test_integration_follows_the_continuous_equations():
    """x' = v, v' = R f + g - 2 W x v, R' = R w^ - W^ R, integrated to 1e-11 by another method."""
    steps = 300

    def derivative(t, y):
        R = y[6:].reshape(3, 3)
        w, f = rate(t), force(t)
        wx = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        W = FAST_EARTH
        Wx = np.array([[0, -W[2], W[1]], [W[2], 0, -W[0]], [-W[1], W[0], 0]])
        v = y[3:6]
        return np.concatenate([v, R @ f + [0, 0, 9.80665] - 2 * np.cross(W, v), (R @ wx - Wx @ R).ravel()])

    x, R = start()
    gyro_bias, accelerometer_bias = x[9:12].copy(), x[12:15].copy()
    exact = solve_ivp(
        derivative, (0, steps * DT), np.concatenate([x[:6], R.ravel()]), method="DOP853", rtol=1e-12, atol=1e-12
    ).y[:, -1]
    means = [
        [quad_vec(g, k * DT, (k + 1) * DT)[0] / DT + b for k in range(steps)]
        for g, b in ((rate, gyro_bias), (force, accelerometer_bias))
    ]
    constant = NOISE.copy()
    constant[[3, 5]] = 1e12  # biases that keep
    run(x, R, *means, noise=constant)
    np.testing.assert_allclose(x[:3], exact[:3], atol=3e-3)
    np.testing.assert_allclose(x[3:6], exact[3:6], atol=2e-3)
    np.testing.assert_allclose(rotation_log(R @ exact[6:].reshape(3, 3).T), 0, atol=2e-5)


def test_the_accumulated_transition_is_the_derivative_of_the_integration():
    """Central differences of 40 samples, errors as in state.py; what differs is of third order in the interval."""
    steps, dt, h = 40, 0.001, 1e-5
    rng = np.random.default_rng(1)
    rates, forces = RATE + 0.3 * rng.standard_normal((steps, 3)), FORCE + rng.standard_normal((steps, 3))
    noise = NOISE.copy()
    noise[3], noise[5] = 0.5, 0.8
    x, R = start()

    def end(error):
        y, S = x + error, rotation_exp(error[6:9]) @ R
        y[6:9] = 0
        run(y, S, rates, forces, noise=noise, dt=dt)
        return y, S

    y, S = x.copy(), R.copy()
    Phi, _ = run(y, S, rates, forces, noise=noise, dt=dt)
    for k in range(15):
        (up, R_up), (down, R_down) = end(h * np.eye(15)[k]), end(-h * np.eye(15)[k])
        column = (up - down) / (2 * h)
        column[6:9] = rotation_log(R_up @ R_down.T) / (2 * h)
        # 40 steps make 4e-5 of a wrong term of dt^2, and 4e-2 of one of dt
        np.testing.assert_allclose(Phi[:, k], column, rtol=2e-5, atol=2e-7, err_msg=f"error state {k}")


def test_the_noise_of_one_sample_moves_position_by_half_its_interval():
    """White noise of the mean force over dt: dv = dt n and dp = dt / 2 dv are fully correlated; that of rates turns."""
    x, R = start()
    Q = run(x, R, [RATE], [FORCE])[1]
    gain = np.vstack([0.5 * DT * np.eye(3), np.eye(3)])
    s_a = IMU.velocity_random_walk_mps_per_rts**2 * DT
    np.testing.assert_allclose(Q[:6, :6], s_a * gain @ gain.T, rtol=1e-12, atol=0)
    np.testing.assert_allclose(
        Q[6:9, 6:9], IMU.angle_random_walk_rad_per_rts**2 * DT * np.eye(3), rtol=1e-12, atol=1e-30
    )


def test_imu_noise_has_the_values_of_the_settings():
    """Compiled code squares random walks, so a wrong sign would not show elsewhere."""
    np.testing.assert_allclose(
        NOISE[:3], [IMU.angle_random_walk_rad_per_rts, IMU.velocity_random_walk_mps_per_rts, IMU.gyro_bias_sd_radps]
    )
    np.testing.assert_allclose(
        NOISE[3:], [IMU.gyro_bias_tau_s, IMU.accelerometer_bias_sd_mps2, IMU.accelerometer_bias_tau_s]
    )
    assert (NOISE > 0).all()


def test_a_bias_that_starts_at_its_standard_deviation_keeps_it():
    noise = NOISE.copy()
    noise[3], noise[5] = 3.0, 2.0
    x, R = start()
    Phi, Q = run(x, R, [RATE] * 100, [FORCE] * 100, noise=noise)
    P = np.zeros((15, 15))
    P[9:12, 9:12] = noise[2] ** 2 * np.eye(3)
    P[12:15, 12:15] = noise[4] ** 2 * np.eye(3)
    P = Phi @ P @ Phi.T + Q
    np.testing.assert_allclose(np.diag(P)[9:12], noise[2] ** 2, rtol=1e-10)
    np.testing.assert_allclose(np.diag(P)[12:15], noise[4] ** 2, rtol=1e-10)


def test_accumulated_noise_is_that_of_every_sample_propagated_to_the_end():
    """Q = sum of Phi_N..k+1 Q_k Phi_N..k+1^T, each factor taken on its own."""
    rng = np.random.default_rng(2)
    rates, forces = RATE + rng.standard_normal((30, 3)), FORCE + rng.standard_normal((30, 3))
    x, R = start()
    y, S = x.copy(), R.copy()
    Phi, Q = run(y, S, rates, forces)
    whole, total = np.eye(15), np.zeros((15, 15))
    for w, f in zip(rates, forces, strict=True):
        F, Q_k = run(x, R, [w], [f])
        whole, total = F @ whole, F @ total @ F.T + Q_k
    np.testing.assert_allclose(Phi, whole, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(Q, total, rtol=1e-10, atol=1e-24)
    np.testing.assert_array_equal(x, y)


def test_the_full_covariance_follows_the_core_states():
    """Reference: T P T^T + Q and T E with T = diag(Phi, 1); the result is bitwise symmetric."""
    rng = np.random.default_rng(6)
    root, Phi, own = rng.standard_normal((40, 40)), rng.standard_normal((15, 15)), rng.standard_normal((15, 15))
    Phi[rng.uniform(size=Phi.shape) < 0.5] = 0.0
    P = root @ root.T
    P = 0.5 * (P + P.T)
    T, Q = np.eye(40), np.zeros((40, 40))
    T[:15, :15], Q[:15, :15] = Phi, own @ own.T
    expected = T @ P @ T.T + Q
    E = rng.standard_normal((40, 3))
    moved = T @ E
    propagate(P, E, Phi, Q[:15, :15].copy())
    np.testing.assert_allclose(E, moved, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(P, expected, rtol=1e-12, atol=1e-10)
    np.testing.assert_array_equal(P, P.T)
