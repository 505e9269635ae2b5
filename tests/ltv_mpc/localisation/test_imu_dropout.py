"""Lost or late inertial samples: the covariance covers the gap, and measurements after it are used."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.frames import rotation
from ltv_mpc.localisation import imu_dropout
from ltv_mpc.localisation.imu_dropout import LEVEL_WALK, TURN_WALK, VELOCITY_WALK
from ltv_mpc.messages import FilterStatus, ImuSample
from tests.ltv_mpc.localisation.dives import CONFIG, REALISTIC, Run, S, dive, normalised

SHALLOW = replace(CONFIG, deepest_m=60.0)
CHI_SQUARE_5 = 28.5  # 3e-5


def assert_nominal(run, of, from_ns=-S):
    assert max(normalised(e, of) for t_ns, e in run.estimates.items() if t_ns > from_ns) < CHI_SQUARE_5
    assert {report.status for report in run.reports.values()} == {FilterStatus.NOMINAL}


@pytest.mark.parametrize(
    "gaps",
    [
        [(4.0, 4.767), (8.0, 8.767), (12.0, 12.767)],  # the end of a delay of 0.767 s
        [(8.0, 11.0)],
        [(4.0 + 0.1 * k, 4.0 + 0.1 * k + 0.09) for k in range(100)],  # one sample of ten
    ],
    ids=["delays", "silence", "slow"],
)
def test_the_truth_stays_within_the_covariance_and_no_sensor_is_reported(gaps):
    """Roll and pitch of 1.5 deg rms with a period of 4 s: over a second the level is another."""
    of = dive(REALISTIC, 4, duration_s=20.0)
    lost = [(round(a * S), round(b * S)) for a, b in gaps]
    kept = (m for m in of.messages if not (isinstance(m, ImuSample) and any(a < m.t_ns <= b for a, b in lost)))
    run = Run(kept, config=SHALLOW)
    assert run.estimator.account["imu.gap"] == len(gaps)
    assert max(run.estimates) == 20 * S  # it continues
    assert_nominal(run, of)


@pytest.mark.parametrize(("seed", "silent_s"), [(20, 6.0), (27, 9.0)])
def test_after_seconds_without_any_sensor_the_filter_is_levelled_and_continues(seed, silent_s):
    """Without levelling each of these is inconsistent within 6 s; the last is then 15 m further off."""
    of = dive(REALISTIC, seed, duration_s=silent_s + 14.0)
    silent = range(4 * S + 1, round((4 + silent_s) * S) + 1)
    assert_nominal(Run((m for m in of.messages if m.t_ns not in silent), config=SHALLOW), of, 4 * S)


def test_coasting_over_a_gap_is_the_same_in_one_part_and_in_two():
    ends = []
    for cuts in ((2.0,), (0.7, 1.3)):
        x, R = np.arange(20.0), rotation(0.1, 0.2, 0.3)
        Phi, Q = np.eye(15), np.diag(np.arange(1.0, 16.0))
        for seconds in cuts:
            imu_dropout.coast(x, R, Phi, Q, seconds, 2.0, 0.1, REALISTIC.imu)
        ends.append((x, R, Phi, Q))
    for one, two in zip(*ends, strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-12, atol=1e-12)


def test_estimates_within_a_gap_do_not_change_its_covariance():
    of, ends = dive(REALISTIC, 4, duration_s=8.0), []
    sample = next(m for m in of.messages if isinstance(m, ImuSample) and m.t_ns == 7 * S)
    for stops in ((), (5 * S, 6 * S)):
        filter_ = Run((m for m in of.messages if m.t_ns <= 4 * S), config=SHALLOW).estimator.filter
        for t_ns in (*stops, 7 * S):
            filter_.advance(t_ns, sample)
        ends.append(filter_.propagated_belief().P)
    np.testing.assert_allclose(*ends, rtol=1e-9, atol=1e-12)


def test_a_sample_that_comes_a_little_early_leaves_no_gap():
    nothing = (0.0, 0.0, 0.0)
    sample = ImuSample(t_ns=S, interval_ns=10_000_000, angular_rate_radps=nothing, specific_force_mps2=nothing)
    gaps = [imu_dropout.gap_before_ns(sample, S - before_ns) for before_ns in (10**7, 14 * 10**6, 5 * 10**6, 2 * 10**7)]
    assert gaps == [0, 0, 0, 10_000_000]


def test_coasting_over_a_gap_has_the_closed_form_of_random_walks():
    imu, T = REALISTIC.imu, 2.0
    x, R, Phi, Q = np.arange(20.0), np.eye(3), np.eye(15), np.zeros((15, 15))
    imu_dropout.coast(x, R, Phi, Q, T, T, 0.15, imu)
    np.testing.assert_allclose(x[:3], [0.0 + 3.0 * T, 1.0 + 4.0 * T, 2.0 + 5.0 * T])
    np.testing.assert_allclose(R, rotation(0.0, 0.0, 0.15 * T), atol=1e-12)
    np.testing.assert_allclose(Phi[:6, :6], np.kron([[1.0, T], [0.0, 1.0]], np.eye(3)))
    q = VELOCITY_WALK * np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]])
    np.testing.assert_allclose(Q[:6, :6], np.kron(q, np.eye(3)), atol=1e-18)
    assert (Q[7, 7], Q[8, 8]) == pytest.approx((LEVEL_WALK * T, TURN_WALK * T**3 / 12))
    for i, sd, tau_s in (
        (9, imu.gyro_bias_sd_radps, imu.gyro_bias_tau_s),
        (12, imu.accelerometer_bias_sd_mps2, imu.accelerometer_bias_tau_s),
    ):
        keep = math.exp(-T / tau_s)
        assert (x[i], Phi[i, i], Q[i, i]) == pytest.approx((keep * i, keep, sd**2 * (1.0 - keep**2)))
