"""Batch least squares over a whole trajectory as the oracle of the filter, with late and out-of-order messages.

Level, heading north, attitude and gyros known: all is linear but a range (``test_acoustic.py``). Unknowns, three axes
each: position and velocity at the start, accelerometer bias, and the velocity noise of every inertial sample.
    v[k+1] = v[k] + dt (f[k] - b) + w[k],  p[k+1] = p[k] + dt (v[k] + v[k+1]) / 2
"""

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import ACCELEROMETER_BIAS, POSITION, VELOCITY, Belief, Layout
from ltv_mpc.localisation.out_of_sequence import MeasurementBuffer
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.messages import BottomTrack, GnssFix, ImuSample, PressureDepth, TdcpFix, UsblFix
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR, with_settings

DT_NS, DT = 20_000_000, 0.02
STEPS = 120
PAPER = SensorConfig.load("paper")
SUITE = with_settings(
    replace(PAPER, usbl=EVERY_SENSOR.usbl, bottom_track=EVERY_SENSOR.bottom_track),
    imu={
        "gyro_bias_sd_radps": 0.0,
        "angle_random_walk_rad_per_rts": 0.0,
        "velocity_random_walk_mps_per_rts": 0.05,
        "accelerometer_bias_sd_mps2": 0.2,
        "accelerometer_bias_tau_s": 1e13,  # constant
    },
    gnss={"position_sd_m": 0.5, "velocity_sd_mps": 0.1, "lever_arm_m": (2.0, -1.0, -3.0)},
    tdcp={"displacement_sd_m": 0.02},
    pressure={"depth_sd_m": 0.05, "lever_arm_m": (-1.0, 0.5, 0.3)},
    usbl={"position_sd_m": 0.7, "lever_arm_m": (0.4, 0.2, -0.5)},
    bottom_track={"beam_noise_sd_mps": 0.03},
)
OPEN = replace(EstimatorConfig(), deepest_m=5.0, gate_probability=1.0)  # every innovation passes
SD = np.repeat([2.0, 0.7, 0.2], 3)  # of position, velocity, bias at the start


class Problem:
    """Whitened rows over all unknowns; p, v, b as affine functions of them, at every sample."""

    def __init__(self, forces):
        self.unknowns = 9 + 3 * STEPS
        eye = np.eye(self.unknowns)
        self.rows = [*(eye[:9] / SD[:, None]), *(eye[9:] / (0.05 * np.sqrt(DT)))]
        self.right = [0.0] * self.unknowns
        p, v, self.b = eye[:3], eye[3:6], eye[6:9]
        at_p, at_v = np.zeros(3), np.zeros(3)
        self.path = [(p, v, at_p, at_v)]
        for k, f in enumerate(forces):
            w = eye[9 + 3 * k : 12 + 3 * k]
            v2, at_v2 = v - DT * self.b + w, at_v + DT * f
            p, at_p = p + 0.5 * DT * (v + v2), at_p + 0.5 * DT * (at_v + at_v2)
            v, at_v = v2, at_v2
            self.path.append((p, v, at_p, at_v))

    def add(self, row, known, z, sd):
        """z = row . unknowns + known + n."""
        self.rows.append(row / sd)
        self.right.append((z - known) / sd)

    def solution(self):
        """[p, v, b] at the last sample, and its covariance."""
        A = np.array(self.rows)
        x = np.linalg.lstsq(A, np.array(self.right), rcond=None)[0]
        p, v, at_p, at_v = self.path[-1]
        T = np.concatenate([p, v, self.b])
        return T @ x + np.concatenate([at_p, at_v, np.zeros(3)]), T @ np.linalg.inv(A.T @ A) @ T.T


def measured(problem, rng):
    """Add rows of all sensors to ``problem``; yield the messages with their latencies."""
    beams = beam_directions(SUITE.adcp.beam_angle_rad)
    antenna, beacon, gauge = (np.array(s.lever_arm_m) for s in (SUITE.gnss, SUITE.usbl, SUITE.pressure))
    epoch = 0
    for k in range(1, STEPS + 1):
        t_ns, (p, v, at_p, at_v) = k * DT_NS, problem.path[k]
        late_ns = int(rng.integers(0, 50)) * DT_NS  # up to a second
        if k % 3 == 0:
            z = float(rng.standard_normal())
            problem.add(p[2], at_p[2] + gauge[2], z, 0.05)
            yield late_ns, PressureDepth(t_ns=t_ns, depth_m=z)
        if k % 20 == 0:
            z = rng.standard_normal(6)
            for i in range(2):
                problem.add(p[i], at_p[i] + antenna[i], z[i], 0.5)
                problem.add(v[i], at_v[i], z[2 + i], 0.1)
                step = problem.path[epoch]
                problem.add(p[i] - step[0][i], at_p[i] - step[2][i], 0.1 * z[4 + i], 0.02)
            n, e, v_n, v_e, d_n, d_e = z.tolist()
            # neither overtakes the next epoch's: a change of position needs the clone of the epoch before
            together_ns = late_ns % (20 * DT_NS)
            yield together_ns, GnssFix(t_ns=t_ns, north_m=n, east_m=e, velocity_north_mps=v_n, velocity_east_mps=v_e)
            yield together_ns, TdcpFix(t_ns=t_ns, from_t_ns=epoch * DT_NS, north_m=0.1 * d_n, east_m=0.1 * d_e)
            epoch = k
        if k % 7 == 0:
            n, e = rng.standard_normal(2).tolist()
            problem.add(p[0], at_p[0] + beacon[0], n, 0.7)
            problem.add(p[1], at_p[1] + beacon[1], e, 0.7)
            yield late_ns, UsblFix(t_ns=t_ns, north_m=n, east_m=e)
        if k % 11 == 0:
            z = 0.3 * rng.standard_normal(4)
            z[k % 4] = np.nan
            for i in np.flatnonzero(~np.isnan(z)):
                problem.add(-beams[i] @ v, -beams[i] @ at_v, z[i], 0.03)
            yield late_ns, BottomTrack(t_ns=t_ns, range_m=z * 0 + 9.0, beam_velocity_mps=z)


@pytest.mark.parametrize("seed", range(2))
def test_all_measurements_of_a_trajectory_are_weighted_as_least_squares_does(seed):
    """1e-8 of the largest, in estimate and covariance, though nearly every message comes after its time."""
    rng = np.random.default_rng(seed)
    forces = rng.standard_normal((STEPS, 3))
    problem = Problem(forces)
    queue = sorted(measured(problem, rng), key=lambda entry: entry[1].t_ns + entry[0])

    belief = Belief.blank(Layout.of(SUITE, OPEN), 0)
    belief.P[:9, :9] = np.diag([*SD[:6], 0.0, 0.0, 0.0]) ** 2
    belief.P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] = np.diag(SD[6:]) ** 2
    belief.clone_position(SUITE.gnss.lever_arm_m)
    filter_ = ErrorStateFilter(SUITE, OPEN, belief)
    buffer = MeasurementBuffer(filter_)
    inserted = 0
    for k in range(1, STEPS + 1 + 50):  # the last of them without news: all that is late has come
        if k <= STEPS:
            force = (forces[k - 1] - [0.0, 0.0, 9.80665]).tolist()
            sample = ImuSample(
                t_ns=k * DT_NS, interval_ns=DT_NS, angular_rate_radps=(0.0, 0.0, 0.0), specific_force_mps2=tuple(force)
            )
            buffer.advance(k * DT_NS, sample)
        while queue and queue[0][1].t_ns + queue[0][0] <= k * DT_NS:
            message = queue.pop(0)[1]
            if message.t_ns == filter_.belief.t_ns:
                buffer.correct(message)
            else:
                buffer.insert(message)
                inserted += 1
    assert not queue
    assert inserted > 50
    assert not [
        name for name, count in filter_.account.items() if count and name.split(".")[1] not in ("used", "no_return")
    ]
    filter_.propagate_covariance()
    at = [*range(POSITION.start, VELOCITY.stop), *range(ACCELEROMETER_BIAS.start, ACCELEROMETER_BIAS.stop)]
    solution, covariance = problem.solution()
    x, P = filter_.belief.x, filter_.belief.P
    np.testing.assert_allclose(x[at], solution, rtol=0, atol=1e-8 * np.abs(solution).max())
    deviation = np.sqrt(np.diagonal(covariance))
    np.testing.assert_allclose((P[np.ix_(at, at)] - covariance) / np.outer(deviation, deviation), 0, atol=1e-8)
