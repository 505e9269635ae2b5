"""IMU dropout: the filter bridges times without inertial samples, because samples are lost or arrive too late.

Bridge   For up to ``MAX_BRIDGED_NS`` the sample after the gap stands for the gap too. Specific force and angular rate
         are modelled as random walks: at T before the sample their variances are q_f T and q_r T. So over the gap
             P_vv += q_f T^3/3,  P_phi,phi += q_r T^3/3
Coast    Beyond that the motion is unknown. The velocity is a random walk. The heading turns at the mean of the rates
         before and after the gap (not at all beyond ``MAX_TURN_S``), and the level nearly stays:
             p := p + T v,  P_pp += q_v T^3/3,  P_pv += q_v T^2/2,  P_vv += q_v T
             P_level += q_l T,  P_heading += q_r min(T, MAX_TURN_S)^2/12 T
         Tilt does not become velocity, because no specific force was measured. Biases change as always.
Level    The first sample after ``MIN_LEVELLED_NS`` of coasting levels the filter. A vehicle that hardly accelerates
         measures gravity,
             (R f)_i = a_i,  a_i ~ N(0, 0.2^2 m2/s4),  north and east:  -(R f)_i = (phi x R f)_i - (R db_a)_i - a_i
         After 8 s the level is uncertain by 6 deg, 1 m/s2. Strapdown integration would take that for motion before a
         ping arrives, and the measurement of both together is no longer linear (an error of 0.5 m became 25 m in 15 s).
So measurements within a gap and after it meet a filter that is as uncertain as it must be, and pass the gate.
Source   Bar-Shalom, Li & Kirubarajan 2001, sections 6.2.2 (white noise acceleration) and 6.2.3 (its random walk).
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.frames import rotation_exp, skew
from ltv_mpc.localisation.filter.state import ACCELEROMETER_BIAS, ATTITUDE, GYRO_BIAS, POSITION, VELOCITY, Belief
from ltv_mpc.localisation.sensors.imu import Imu
from ltv_mpc.localisation.sensors.sensor import Rows
from ltv_mpc.messages import Array, ImuSample, Triple

VELOCITY_WALK = 0.1**2  # m2/s3: what thrusters can do, and more
TURN_WALK = 0.1**2  # rad2/s3
FORCE_WALK = 0.2**2  # m2/s5: full thrust within 0.6 s
LEVEL_WALK = 0.04**2  # rad2/s: roll and pitch in a light sea

MAX_BRIDGED_NS = 100_000_000
MIN_LEVELLED_NS = 1_000_000_000
"""Minimum time of coasting after which a sample levels the filter: before, the level is known as well as that."""

ACCELERATION_SD_MPS2 = 0.2  # of the vehicle during levelling
MAX_TURN_S = 4.0
"""Time for which a turn is assumed to continue; after it the rate of turn is unknown, 0.1 rad/s either way."""


def gap_before_ns(sample: ImuSample, t_ns: int) -> int:
    """Return the time between ``t_ns`` and the interval of a sample (ns); 0 if less than half of that interval.

    Parameters
    ----------
    sample : inertial sample after ``t_ns``.
    t_ns : time of the filter (ns).
    """
    gap_ns = sample.t_ns - sample.interval_ns - t_ns
    return gap_ns if 2 * gap_ns > sample.interval_ns else 0


def inflate(Q: Array, seconds: float, gap_s: float) -> None:
    """Add the noise of a bridged part of a gap.

    Parameters
    ----------
    Q : (15, 15) process noise of the core states, changed in place.
    seconds : length of the part (s).
    gap_s : length of the whole gap (s).
    """
    vv, aa = np.arange(VELOCITY.start, VELOCITY.stop), np.arange(ATTITUDE.start, ATTITUDE.stop)
    Q[vv, vv] += FORCE_WALK * gap_s**2 / 3.0 * seconds
    Q[aa, aa] += TURN_WALK * gap_s**2 / 3.0 * seconds


def coast(x: Array, R: Array, Phi: Array, Q: Array, seconds: float, gap_s: float, turn_radps: float, imu: Imu) -> None:
    """Propagate a part of a gap, in place, as ``strapdown.integrate`` propagates a sample.

    Parameters
    ----------
    x, R : states, and attitude (3, 3), body to NED.
    Phi, Q : (15, 15) transition and process noise since the covariance was propagated.
    seconds : length of the part (s).
    gap_s : length of the whole gap (s).
    turn_radps : mean rate of the heading over the gap (rad/s).
    imu : settings of the inertial unit, for its biases.
    """
    x[POSITION] += seconds * x[VELOCITY]
    if gap_s <= MAX_TURN_S:
        R[:, :] = rotation_exp(np.array([0.0, 0.0, seconds * turn_radps])) @ R
    A, noise = np.eye(len(Phi)), np.zeros(len(Phi))
    A[POSITION, VELOCITY] = seconds * np.eye(3)
    noise[ATTITUDE] = LEVEL_WALK * seconds
    noise[ATTITUDE.stop - 1] = TURN_WALK * min(gap_s, MAX_TURN_S) ** 2 / 12.0 * seconds
    for states, sd, tau_s in (
        (GYRO_BIAS, imu.gyro_bias_sd_radps, imu.gyro_bias_tau_s),
        (ACCELEROMETER_BIAS, imu.accelerometer_bias_sd_mps2, imu.accelerometer_bias_tau_s),
    ):
        keep = math.exp(-seconds / tau_s)
        x[states] *= keep
        A[states, states] *= keep
        noise[states] = sd**2 * (1.0 - keep * keep)
    Phi[:, :] = A @ Phi
    Q[:, :] = A @ Q @ A.T + np.diag(noise)
    p, v = np.arange(POSITION.start, POSITION.stop), np.arange(VELOCITY.start, VELOCITY.stop)
    Q[p, p] += VELOCITY_WALK * seconds**3 / 3.0
    Q[p, v] += VELOCITY_WALK * seconds**2 / 2.0
    Q[v, p] += VELOCITY_WALK * seconds**2 / 2.0
    Q[v, v] += VELOCITY_WALK * seconds


def level(belief: Belief, force: Triple) -> Rows:
    """Return the two rows by which a specific force levels the filter after a gap.

    Parameters
    ----------
    belief : the filter's belief.
    force : specific force (m/s2, body).
    """
    f = belief.R @ (np.array(force) - belief.x[ACCELEROMETER_BIAS])
    return Rows(
        state=np.tile(np.r_[ATTITUDE, ACCELEROMETER_BIAS], (2, 1)),
        partial=np.hstack([-skew(f)[:2], -belief.R[:2]]),
        residual=-f[:2],
        variance=np.full(2, ACCELERATION_SD_MPS2**2),
    )
