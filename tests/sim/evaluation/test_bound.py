"""The bound against the figures of a one-axis analysis and against a covariance filter."""

import math

import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.sensor_config import SensorConfig
from sim.evaluation.cramer_rao_bound import Trajectory, bound
from sim.evaluation.cramer_rao_bound import model as model_of_errors
from sim.evaluation.cramer_rao_bound.analysis import schedule
from sim.evaluation.cramer_rao_bound.model import ATTITUDE, BEAM_BIAS, EPOCH, MOVING, POSITION, WATER, ErrorModel, at
from tests.ltv_mpc.localisation.sensors.every_sensor import with_settings

PAPER, REALISTIC = SensorConfig.load("paper"), SensorConfig.load("realistic")
ONE_AXIS = ("heading", "vertical")


def descent(surface_s, duration_s=200.0, nodes=74):
    """Level, northward, still afloat; then down at 0.2 m/s: each axis on its own."""
    t = np.round(np.arange(-surface_s, duration_s + 0.05, 0.1), 6)
    position, velocity = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    position[:, 2], velocity[t > 0, 2] = 0.2 * np.maximum(t, 0.0), 0.2
    return Trajectory(t, position, velocity, np.broadcast_to(np.eye(3), (len(t), 3, 3)), np.zeros((nodes, 2)))


def swaying(duration_s, seed=0, nodes=8, surface_s=1.0):
    """Return a motion that rolls, pitches, turns and accelerates in sheared water."""
    rng = np.random.default_rng(seed)
    t = np.round(np.arange(-surface_s, duration_s + 0.025, 0.05), 6)
    w = 2 * math.pi / np.array([4.0, 4.4, 30.0])
    roll, pitch, heading = (0.04 * np.sin(w[0] * t), 0.04 * np.cos(w[1] * t), 0.7 + 0.5 * np.sin(w[2] * t))
    velocity = np.column_stack([0.2 * np.sin(0.3 * t), 0.1 * np.cos(0.2 * t), 0.1 * (t > 0)])
    position = np.column_stack([-np.cos(0.3 * t) / 1.5, 0.5 * np.sin(0.2 * t), 0.1 * np.maximum(t, 0.0)])
    R = np.array([rotation(*angles) for angles in zip(roll, pitch, heading, strict=True)])
    return Trajectory(t, position, velocity, R, 0.1 * rng.standard_normal((nodes, 2)))


def of_the_table(*, realistic_adcp=False):
    """Constant biases, and as many cells along the vertical as the range has metres."""
    source = REALISTIC.adcp if realistic_adcp else PAPER.adcp
    slant = 1 / math.cos(source.beam_angle_rad)
    noise, range_m = source.beam_noise_sd_mps, source.range_m * slant + 0.01
    return with_settings(
        PAPER,
        imu={"gyro_bias_tau_s": 1e9, "accelerometer_bias_tau_s": 1e9},
        adcp={"beam_noise_sd_mps": noise, "cell_m": slant, "range_m": range_m},
    )


# Drift after 200 s (m), and velocity then (mm/s), of one axis; from an analysis that is not this project's code.
TABLE = {
    "inertial only, tilt known, perfect gyros": (of_the_table(), 30, ("tilt", "gyro_bias"), ("adcp",), 2.7, None),
    "paper, 1 fix": (of_the_table(), 1, (), (), 1.01, 5.3),
    "paper, satellite velocity only": (of_the_table(), 1, (), ("tdcp",), 2.63, 13.3),
    "realistic ADCP, 1 fix": (of_the_table(realistic_adcp=True), 1, (), (), 1.23, 7.7),
}


@pytest.mark.parametrize("case", TABLE)
def test_one_axis_cases_agree_with_the_one_axis_analysis_within_ten_per_cent(case):
    suite, surface_s, known, without, drift_m, velocity_mmps = TABLE[case]
    result = bound(
        suite,
        EstimatorConfig(deepest_m=73.0),
        descent(surface_s),
        at_s=[200.0],
        surface_time_s=surface_s,
        known=(*ONE_AXIS, *known),
        without=without,
    )
    np.testing.assert_allclose(result.drift_rms_m, drift_m, rtol=0.1)
    if velocity_mmps is not None:
        north, east = result.covariance[0].diagonal()[3:5]
        np.testing.assert_allclose(1e3 * np.sqrt(0.5 * (north + east)), velocity_mmps, rtol=0.1)


def test_every_reading_of_the_gauge_is_used_once_at_the_instant_nearest_to_it():
    events = schedule(PAPER, [2.0], 1.0, ())
    assert sum(event.depths for event in events) == 31  # 10 Hz from -1 to 2 s
    assert max(event.depths for event in events) <= 4
    assert [event.t_s for event in events] == sorted(event.t_s for event in events)
    assert sum("gnss" in event.kinds for event in events) == 2
    assert sum("adcp" in event.kinds for event in events) == 10


def kalman(suite, config, trajectory, at_s, surface_s):
    """Compute it by a covariance filter in Joseph's form: clones copied, the error at t = 0 carried along unchanged."""
    model = ErrorModel(suite, config)
    free = np.flatnonzero(model.free)
    n = model.size
    P = np.zeros((n, n))
    prior = [i for i in free if i < 16 or i >= BEAM_BIAS.start]
    P[np.ix_(prior, prior)] = np.linalg.inv(model.prior()[np.ix_(prior, prior)])
    cross, start = np.zeros((n, 3)), np.zeros((3, 3))  # cov(error now, published error of position at 0), its own
    result = {}
    events = schedule(suite, [*at_s, 0.0], surface_s, ())
    epoch = False
    for i, event in enumerate(events):
        now = at(trajectory, event.t_s)
        rows = [model.levelling(now)] if i == 0 else []
        rows += [model.gnss(now)] if "gnss" in event.kinds else []
        rows += [model.tdcp()] if "tdcp" in event.kinds and epoch else []
        rows += [model.adcp(now, trajectory.water_mps)] if "adcp" in event.kinds else []
        rows += [model.compass(now)] if "compass" in event.kinds else []
        rows += [model.pressure(now, event.depths)] if event.depths else []
        H = np.vstack(rows)
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.eye(len(H)))
        keep = np.eye(n) - K @ H
        P = keep @ P @ keep.T + K @ K.T
        cross = keep @ cross
        if event.t_s == 0.0:
            cross, start = P[:, POSITION].copy(), P[POSITION, POSITION].copy()
        for t in (t for t in at_s if abs(t - event.t_s) < 0.01):
            drift = np.zeros((3, 3))
            if event.t_s > 0:
                C = cross[POSITION]
                drift = P[POSITION, POSITION] + start - C - C.T
            result[t] = P[:15, :15], drift
        if i + 1 == len(events):
            break
        if "gnss" in event.kinds and event.t_s < 0:
            epoch = True
            P[EPOCH], P[:, EPOCH] = P[POSITION], P[:, POSITION]
            P[EPOCH, EPOCH] = P[POSITION, POSITION]
        ahead = events[i + 1].t_s
        Phi, Q = np.eye(n), np.zeros((n, n))
        Phi[:MOVING, :MOVING], Q[:MOVING, :MOVING] = model.growth(now, at(trajectory, ahead), ahead - event.t_s)
        water = np.arange(WATER, n)
        Q[water, water] = config.current_change_mps_per_rts**2 * (ahead - event.t_s)
        P = Phi @ P @ Phi.T + Q
        cross = Phi @ cross
    return result


@pytest.mark.parametrize(("suite", "walk"), [(PAPER, 0.0), (REALISTIC, 0.002)], ids=["paper", "realistic"])
def test_information_and_a_covariance_filter_come_to_the_same(suite, walk, monkeypatch):
    """Schur complements and positions kept, against gains, Joseph's form and clones; drift against an error carried.

    Nothing known to begin with is 30 m here: with 10 km, the covariance filter's own rounding is worse than 10 %.
    """
    monkeypatch.setattr(model_of_errors, "_ANYWHERE", 1e-3)
    suite = with_settings(suite, adcp={"range_m": 4.0}, imu={"gyro_bias_tau_s": 50.0})
    config = EstimatorConfig(deepest_m=7.0, current_change_mps_per_rts=walk)
    trajectory = swaying(6.0, surface_s=3.0)
    at_s = [-1.0, 0.0, 2.0, 6.0]
    result = bound(suite, config, trajectory, at_s=at_s, surface_time_s=3.0)
    expected = kalman(suite, config, trajectory, at_s, 3.0)
    for k, t in enumerate(at_s):
        P, drift = expected[t]
        sd = np.sqrt(np.maximum(np.diag(P), 1e-30))
        np.testing.assert_allclose(result.covariance[k] / np.outer(sd, sd), P / np.outer(sd, sd), atol=1e-4)
        np.testing.assert_allclose(result.drift[k], drift, atol=3e-3 * max(np.trace(drift), 1e-12))


def test_a_share_of_beams_that_is_lost_weighs_as_much_as_noise():
    """Half of the beams missing is the same as sqrt(2) of the noise, by definition of information."""
    lost = with_settings(PAPER, adcp={"missing_share": 0.5})
    noisy = with_settings(PAPER, adcp={"beam_noise_sd_mps": math.sqrt(2) * PAPER.adcp.beam_noise_sd_mps})
    config, trajectory = EstimatorConfig(deepest_m=7.0), swaying(5.0)
    a, b, plain = (
        bound(s, config, trajectory, at_s=[5.0], surface_time_s=1.0).covariance for s in (lost, noisy, PAPER)
    )
    sd = np.sqrt(np.diag(b[0]))
    np.testing.assert_allclose(a[0] / np.outer(sd, sd), b[0] / np.outer(sd, sd), atol=1e-6)
    assert a[0, 3, 3] > 1.05 * plain[0, 3, 3]


def test_what_is_known_has_no_variance_and_nothing_has_drifted_at_submergence():
    config, trajectory = EstimatorConfig(deepest_m=7.0), swaying(2.0)

    def bounds(at_s=(0.0, 2.0), **settings):
        return bound(PAPER, config, trajectory, at_s=at_s, surface_time_s=1.0, **settings)

    known = bounds(known=("heading", "tilt"))
    np.testing.assert_array_equal(known.covariance[:, ATTITUDE], 0)
    assert (np.diag(known.covariance[1])[:6] > 0).all()
    np.testing.assert_array_equal(known.drift[0], 0)
    assert known.drift_rms_m[1] > 0
    with pytest.raises(KeyError):
        bounds(known=("altitude",))
    with pytest.raises(ValueError, match="first satellite fix at -1 s"):
        bounds(at_s=[-1.5, 2.0])
