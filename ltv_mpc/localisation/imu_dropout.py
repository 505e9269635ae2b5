"""Over a time of which the inertial unit said nothing: lost samples, or those that came too late.

Bridged  up to ``MAX_BRIDGED_NS``: the sample after the gap stands for it too. Specific force and rate of turn are held
         to have walked up to it at random, so T before it they were off by q_f T and q_r T, and over the gap
             P_vv += q_f T^3/3,  P_phi,phi += q_r T^3/3
Coasted  beyond: nobody knows how the vehicle went on. Its velocity walks, its heading turns as the mean of the rates
         before and after (as none, beyond ``MAX_TURN_S``), its level stays as it was or nearly so:
             p := p + T v,  P_pp += q_v T^3/3,  P_pv += q_v T^2/2,  P_vv += q_v T
             P_level += q_l T,  P_heading += q_r min(T, MAX_TURN_S)^2/12 T
         No tilt becomes velocity, since no specific force was measured. Biases go on as ever.
Levelled by the first sample after ``MIN_LEVELLED_NS`` of it: a vehicle that hardly accelerates feels what holds it up,
             (R f)_i = a_i,  a_i ~ N(0, 0.2^2 m2/s4),  north and east:  -(R f)_i = (phi x R f)_i - (R db_a)_i - a_i
         After 8 s the level is open by 6 deg, 1 m/s2: strapdown integration takes that for motion before a ping comes,
         and what pings then tell of both at once is no longer linear (0.5 m off became 25 m within 15 s).
So what is measured within a gap, and after it, finds a filter that is as unsure as it must be, and passes the gate.
Source   Bar-Shalom, Li & Kirubarajan 2001, sections 6.2.2 (white noise acceleration) and 6.2.3 (its walk).
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.frames import rotation_exp, skew
from ltv_mpc.localisation.filter.state import ACCELEROMETER_BIAS, ATTITUDE, GYRO_BIAS, POSITION, VELOCITY, Belief
from ltv_mpc.localisation.sensors.imu import Imu
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.messages import Array, ImuSample, Triple

VELOCITY_WALK = 0.1**2  # m2/s3: what thrusters can do, and more
TURN_WALK = 0.1**2  # rad2/s3
FORCE_WALK = 0.2**2  # m2/s5: full thrust within 0.6 s
LEVEL_WALK = 0.04**2  # rad2/s: roll and pitch in a light sea

MAX_BRIDGED_NS = 100_000_000
MIN_LEVELLED_NS = 1_000_000_000
"""After less the level is known as well as this would tell."""

ACCELERATION_SD_MPS2 = 0.2  # of the vehicle when it is levelled
MAX_TURN_S = 4.0
"""For longer no vehicle turns as it did; beyond, the rate of turn is one of 0.1 rad/s either way."""


def gap_before_ns(sample: ImuSample, t_ns: int) -> int:
    """How much time from ``t_ns`` on (ns) ``sample`` does not cover; 0 where that is less than half of what it does."""
    gap_ns = sample.t_ns - sample.interval_ns - t_ns
    return gap_ns if 2 * gap_ns > sample.interval_ns else 0


def inflate(Q: Array, seconds: float, gap_s: float) -> None:
    """Noise of a bridged stretch of ``seconds``, the gap being ``gap_s`` from its beginning; Q (15, 15), in place."""
    vv, aa = np.arange(VELOCITY.start, VELOCITY.stop), np.arange(ATTITUDE.start, ATTITUDE.stop)
    Q[vv, vv] += FORCE_WALK * gap_s**2 / 3.0 * seconds
    Q[aa, aa] += TURN_WALK * gap_s**2 / 3.0 * seconds


def coast(x: Array, R: Array, Phi: Array, Q: Array, seconds: float, gap_s: float, turn_radps: float, imu: Imu) -> None:
    """``seconds`` of a gap of ``gap_s``, in place: as ``preintegration.integrate``. ``turn_radps``: of the heading."""
    x[POSITION] += seconds * x[VELOCITY]
    if gap_s <= MAX_TURN_S:
        R[:, :] = rotation_exp(np.array([0.0, 0.0, seconds * turn_radps])) @ R
    A, noise = np.eye(len(Phi)), np.zeros(len(Phi))
    p, v = np.arange(POSITION.start, POSITION.stop), np.arange(VELOCITY.start, VELOCITY.stop)
    A[p, v] = seconds
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
    Q[p, p] += VELOCITY_WALK * seconds**3 / 3.0
    Q[p, v] += VELOCITY_WALK * seconds**2 / 2.0
    Q[v, p] += VELOCITY_WALK * seconds**2 / 2.0
    Q[v, v] += VELOCITY_WALK * seconds


_LEVEL = np.array([[*range(ATTITUDE.start, ATTITUDE.stop), *range(ACCELEROMETER_BIAS.start, ACCELEROMETER_BIAS.stop)]])


def level(belief: Belief, force: Triple) -> Rows:
    """Two rows: what the specific force (m/s2, body) after a gap says of the vehicle's level."""
    f = belief.R @ (np.array(force) - belief.x[ACCELEROMETER_BIAS])
    return Rows(
        state=np.repeat(_LEVEL, 2, axis=0),
        partial=np.hstack([-skew(f)[:2], -belief.R[:2]]),
        residual=-f[:2],
        variance=np.full(2, ACCELERATION_SD_MPS2**2),
    )
