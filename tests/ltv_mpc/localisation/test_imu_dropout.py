"""Lost or late inertial samples: the covariance covers the gap, and measurements after it are used."""

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import roll_pitch_heading, rotation, wrap_angle
from ltv_mpc.localisation import imu_dropout
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import Estimate, FilterStatus, ImuSample, LocalisationReport

SUITE = SensorConfig.load("realistic")
CONFIG = msgspec.structs.replace(EstimatorConfig(), deepest_m=60.0, kept_m=0.0)
S = 1_000_000_000
CHI_SQUARE_5 = 28.5  # 3e-5


@pytest.fixture(scope="module")
def dive(make_dive):
    """Roll and pitch of 1.5 deg rms with a period of 4 s: over a second the level is another."""
    return make_dive(SUITE, 4, duration_s=17.0)


def flown(messages, inbox_of):
    estimator = Estimator(SUITE, CONFIG)
    return estimator, [said for m in messages for said in estimator.step(m.t_ns, inbox_of(m))]


def without(dive, gaps):
    """Return the messages without the samples of the gaps (start, end], in seconds."""
    lost = [(round(a * S), round(b * S)) for a, b in gaps]
    return [m for m in dive.messages if not (isinstance(m, ImuSample) and any(a < m.t_ns <= b for a, b in lost))]


def normalised(said, dive):
    """Return the normalised squared errors of position, velocity and heading at each estimate."""
    squares = []
    for estimate in (one for one in said if isinstance(one, Estimate)):
        k = dive.at(estimate.t_ns)
        found = [estimate.north_m, estimate.east_m, estimate.velocity_north_mps, estimate.velocity_east_mps]
        off = np.subtract(found, [*dive.position[k, :2], *dive.velocity[k, :2]])
        heading = wrap_angle(estimate.heading_rad - roll_pitch_heading(dive.R[k])[2])
        d, P = np.array([*off, heading]), estimate.covariance[:5, :5]
        squares.append(d @ np.linalg.solve(P, d))
    return squares


@pytest.mark.parametrize(
    "gaps",
    [
        [(4.0, 4.767), (8.0, 8.767), (12.0, 12.767)],  # the end of a delay of 0.767 s
        [(8.0, 11.0)],
        [(4.0 + 0.1 * k, 4.0 + 0.1 * k + 0.09) for k in range(100)],  # one sample of ten
    ],
    ids=["delays", "silence", "slow"],
)
def test_the_truth_stays_within_the_covariance_and_no_sensor_is_reported(dive, inbox_of, gaps):
    estimator, said = flown(without(dive, gaps), inbox_of)
    assert estimator.account["imu.gap"] == len(gaps)
    assert max(normalised(said, dive)) < CHI_SQUARE_5
    reports = [one for one in said if isinstance(one, LocalisationReport)]
    assert {report.status for report in reports} == {FilterStatus.NOMINAL}
    assert said[-1].t_ns == 17 * S  # it goes on


@pytest.mark.parametrize(("seed", "silent_s"), [(20, 6.0), (27, 9.0)])
def test_after_seconds_without_any_sensor_the_filter_is_levelled_and_continues(make_dive, inbox_of, seed, silent_s):
    """Without levelling each of these is inconsistent within 6 s; the last is then 15 m further off."""
    dive = make_dive(SUITE, seed, duration_s=silent_s + 14.0)
    silent = range(4 * S + 1, round((4 + silent_s) * S) + 1)
    _, said = flown([m for m in dive.messages if m.t_ns not in silent], inbox_of)
    assert max(normalised([one for one in said if one.t_ns > 4 * S], dive)) < CHI_SQUARE_5
    reports = [one for one in said if isinstance(one, LocalisationReport)]
    assert {report.status for report in reports} == {FilterStatus.NOMINAL}


def test_coasting_over_a_gap_is_the_same_in_one_part_and_in_two():
    ends = []
    for cuts in ((2.0,), (0.7, 1.3)):
        x, R = np.arange(20.0), rotation(0.1, 0.2, 0.3)
        Phi, Q = np.eye(15), np.diag(np.arange(1.0, 16.0))
        for seconds in cuts:
            imu_dropout.coast(x, R, Phi, Q, seconds, 2.0, 0.1, SUITE.imu)
        ends.append((x, R, Phi, Q))
    for one, two in zip(*ends, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-12, atol=1e-12)
    x, R, Phi, Q = ends[0]
    np.testing.assert_allclose(x[:3], np.arange(3.0) + 2.0 * np.arange(3.0, 6.0))
    assert roll_pitch_heading(R) == pytest.approx((0.1, 0.2, 0.3 + 0.2))
    assert Phi[0, 3] == pytest.approx(2.0)
    assert Q[3, 3] == pytest.approx(4.0 + imu_dropout.VELOCITY_WALK * 2.0)
    assert Q[0, 0] == pytest.approx(1.0 + 2.0**2 * 4.0 + imu_dropout.VELOCITY_WALK * 2.0**3 / 3.0)
    assert Q[8, 8] == pytest.approx(9.0 + imu_dropout.TURN_WALK * 2.0**2 / 12.0 * 2.0)


def test_a_sample_that_comes_a_little_early_leaves_no_gap():
    sample = ImuSample(
        t_ns=1_000_000_000, interval_ns=10_000_000, angular_rate_radps=(0.0,) * 3, specific_force_mps2=(0.0,) * 3
    )
    assert (
        imu_dropout.gap_before_ns(sample, 990_000_000)
        == imu_dropout.gap_before_ns(sample, 986_000_000)
        == imu_dropout.gap_before_ns(sample, 995_000_000)
        == 0
    )
    assert imu_dropout.gap_before_ns(sample, 980_000_000) == 10_000_000
