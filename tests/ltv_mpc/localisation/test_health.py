"""Health of sensors and filter, and samples for the report, on innovations that are consistent or not."""

import numpy as np
import pytest
from scipy.stats import chi2

from ltv_mpc.localisation.filter.error_state_filter import Innovations
from ltv_mpc.localisation.health import (
    FALSE_ALARM,
    MAX_ROWS,
    HealthMonitor,
    InnovationSamples,
    band,
    filter_status,
    innovation_statistics,
)
from ltv_mpc.messages import FilterStatus, SensorStatus
from tests.ltv_mpc.localisation.dives import REALISTIC, S

GATE = 0.999
PERIODS = {"adcp": 333_333_333, "pressure": 100_000_000, "compass": S}
ROWS = {"adcp": 60, "pressure": 1, "compass": 1}
WRONG, REJECTED = FilterStatus.INCONSISTENT, SensorStatus.REJECTED


def observe(monitor, rng, seconds, sensor, scale=1.0, outliers=0.0, start_s=0.0):
    """Feed ``seconds`` of one sensor's innovations, ``scale`` times as large as the filter expects."""
    limit = chi2.ppf(GATE, 1)
    for t in np.arange(start_s * S + PERIODS[sensor], (start_s + seconds) * S + 1, PERIODS[sensor]):
        m = ROWS[sensor]
        S_ii = rng.uniform(0.5, 2.0, m)
        r = scale * np.sqrt(S_ii) * rng.standard_normal(m)
        r[rng.random(m) < outliers] += 50.0
        monitor.observe(Innovations(sensor, int(t), np.arange(m), r, np.diag(S_ii), r**2 / S_ii <= limit))


def reports(monitor, t_s, account=None):
    return {r.sensor: r for r in monitor.sensors(int(t_s * S), account or {})}


def judged(seed, **wrong):
    """Return the reports after 12 s, by sensor, and the status of the filter."""
    monitor, rng = HealthMonitor(REALISTIC, GATE), np.random.default_rng(seed)
    for sensor in PERIODS:
        observe(monitor, rng, 12.0, sensor, **wrong.get(sensor, {}))
    found = reports(monitor, 12.0)
    return found, filter_status(tuple(found.values()))


def test_sensors_as_their_file_says_are_ok_and_their_nis_is_one_for_any_gate():
    """1.3 % too small without the correction for the gate: 12,000 rows have a mean good to 1.3 % (1 sigma)."""
    means = []
    for seed in range(60):
        found, status = judged(seed)
        assert set(found) == {"gnss", "tdcp", "adcp", "pressure", "compass"}  # those of the vehicle
        assert {found[name].status for name in PERIODS} == {SensorStatus.OK}
        assert status == (FilterStatus.NOMINAL, "")
        means.append(found["adcp"].nis)
    assert np.mean(means) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (60 * 30 * 60)))


def test_outliers_are_rejected_and_do_not_make_the_sensor_inconsistent():
    adcp = judged(1, adcp={"outliers": 0.05})[0]["adcp"]
    assert adcp.status is SensorStatus.OK
    assert adcp.nis == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(
    ("scale", "sensor", "of_filter"),
    [
        (2.2, "adcp", WRONG),
        (1.25, "adcp", FilterStatus.NOMINAL),  # noisier than its file says
        (0.3, "adcp", FilterStatus.NOMINAL),
        (2.2, "pressure", WRONG),
    ],
)
def test_innovations_larger_or_smaller_than_expected_make_a_sensor_inconsistent(scale, sensor, of_filter):
    found, status = judged(2, **{sensor: {"scale": scale}})
    assert found[sensor].status is SensorStatus.INCONSISTENT
    assert {found[name].status for name in PERIODS if name != sensor} == {SensorStatus.OK}
    assert status[0] is of_filter


def test_a_rejected_sensor_is_a_filter_fault_if_it_is_essential_or_not_alone():
    mostly = {"scale": 20.0}
    found, (status, why) = judged(3, adcp=mostly)
    assert (found["adcp"].status, status) == (REJECTED, WRONG)
    assert "adcp: more than half of its measurements fail the gate" in why
    found, (status, _) = judged(4, compass=mostly)
    assert (found["compass"].status, status) == (REJECTED, FilterStatus.NOMINAL)
    assert judged(4, compass=mostly, pressure=mostly)[1][0] is WRONG


def test_a_sensor_is_silent_after_three_periods_but_not_satellites_under_water():
    monitor, rng = HealthMonitor(REALISTIC, GATE), np.random.default_rng(5)
    assert reports(monitor, -1.0)["gnss"].status is SensorStatus.SILENT
    for sensor in PERIODS:
        observe(monitor, rng, 12.0, sensor)
    assert reports(monitor, 12.9)["adcp"].status is SensorStatus.OK
    found = reports(monitor, 13.1)
    assert (found["adcp"].status, found["adcp"].last_t_ns) == (SensorStatus.SILENT, 36 * 333_333_333)
    assert {found[name].status for name in ("compass", "gnss", "tdcp")} == {SensorStatus.OK}


def test_innovations_older_than_the_window_do_not_count():
    monitor, rng = HealthMonitor(REALISTIC, GATE), np.random.default_rng(6)
    observe(monitor, rng, 6.0, "adcp", scale=20.0)
    observe(monitor, rng, 4.0, "adcp", start_s=6.0)
    assert reports(monitor, 10.0)["adcp"].status is REJECTED
    observe(monitor, rng, 6.5, "adcp", start_s=10.0)
    assert reports(monitor, 16.5)["adcp"].status is SensorStatus.OK
    monitor.reset()
    assert reports(monitor, 16.6)["adcp"].nis is None


def test_counts_are_those_since_the_last_report_with_the_reason():
    monitor = HealthMonitor(REALISTIC, GATE)
    account = {"adcp.used": 100, "adcp.gate": 3, "adcp.late_applied": 1, "adcp.deweighted": 2, "adcp_like.gate": 5}
    first = reports(monitor, 1.0, account)["adcp"]
    assert (first.used, first.rejected) == (100, {"gate": 3})
    second = reports(monitor, 2.0, account | {"adcp.used": 150, "adcp.no_return": 7})["adcp"]
    assert (second.used, second.rejected) == (50, {"no_return": 7})


def test_rows_that_share_an_error_count_as_fewer_independent_ones():
    """Fifty rows with a correlation of 0.7: the mean square of a window strays more than that of 1500, and is right."""
    rng, m, rho = np.random.default_rng(8), 50, 0.7
    covariance = (1 - rho) * np.eye(m) + rho
    L, nis, limit = np.linalg.cholesky(covariance), [], np.sqrt(chi2.ppf(GATE, 1))
    for _ in range(200):
        monitor = HealthMonitor(REALISTIC, GATE)
        for k in range(30):
            r = L @ rng.standard_normal(m)
            monitor.observe(Innovations("adcp", (k + 1) * 333_333_333, np.arange(m), r, covariance, np.abs(r) <= limit))
        adcp = reports(monitor, 10.0)["adcp"]
        assert adcp.status is SensorStatus.OK
        nis.append(adcp.nis)
    assert np.std(nis) == pytest.approx(np.sqrt(2 / (30 * m * m / np.sum(covariance**2))), rel=0.2)
    low, high = band(30 * m)
    assert max(nis) > high
    assert chi2.sf(30 * m * high, 30 * m) == pytest.approx(FALSE_ALARM)
    assert chi2.cdf(30 * m * low, 30 * m) == pytest.approx(FALSE_ALARM)


def test_only_rows_that_passed_enter_the_statistics():
    """Squared correlations of those that passed, of unlike variances."""
    rng = np.random.default_rng(4)
    root = rng.standard_normal((12, 3))
    covariance = root @ root.T + np.diag(rng.uniform(0.1, 9.0, 12))
    residual, accepted = rng.standard_normal(12), np.arange(12) != 5
    kept = covariance[np.ix_(accepted, accepted)]
    covariance[5, :] = covariance[:, 5] = np.nan
    passed, squares, pairs = innovation_statistics(residual, covariance, accepted)
    variance = np.diag(kept)
    assert passed == 11
    assert squares == pytest.approx(np.sum(residual[accepted] ** 2 / variance))
    assert pairs == pytest.approx(np.sum(kept**2 / np.outer(variance, variance)))


def sampled(*innovations):
    """Return (sensor, rows, innovations, sd) after messages (sensor, residual, accepted, indices).

    Row i has the standard deviation i + 1, and correlates with the others.
    """
    samples = InnovationSamples()
    for t_ns, (sensor, residual, accepted, indices) in enumerate(innovations):
        m, sd = len(residual), np.arange(1.0, len(residual) + 1)
        covariance = np.outer(sd, sd) * (0.5 + 0.5 * np.eye(m))
        samples.observe(
            Innovations(sensor, t_ns, np.array(indices), np.array(residual), covariance, np.array(accepted, dtype=bool))
        )
    found = [(one.sensor, one.rows, one.innovations, one.sd) for one in samples.take()]
    assert samples.take() == ()
    return found


def test_samples_are_rows_of_the_newest_message_of_each_sensor_that_passed():
    compass, failed = [("compass", [x], [True], [0]) for x in (0.1, 0.2)], ("pressure", [90.0], [False], [0])
    gnss = ("gnss", [1.0, 90.0, 3.0, 4.0], [True, False, True, True], range(4))
    assert sampled(compass[0], gnss, compass[1], failed) == [
        ("compass", (0,), (0.2,), (1.0,)),
        ("gnss", (0, 2, 3), (1.0, 3.0, 4.0), (1.0, 3.0, 4.0)),
    ]
    lbl = [("lbl", [1.0 + j], [True], [j]) for j in (0, 3)]  # each transponder is a source
    assert [rows for _, rows, _, _ in sampled(*lbl)] == [(0,), (3,)]


def test_of_a_profiler_four_rows_at_equal_steps_are_shown():
    ((_, rows, innovations, _),) = sampled(("adcp", list(range(56)), [True] * 56, range(100, 156)))
    assert (rows, innovations) == ((100, 114, 128, 142), (0.0, 14.0, 28.0, 42.0))
    for m in range(1, 60):
        assert len(sampled(("adcp", [0.0] * m, [True] * m, range(m)))[0][1]) <= MAX_ROWS
