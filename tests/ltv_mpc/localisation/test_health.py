"""Health of sensors and filter, on synthetic innovations that are consistent or not."""

import numpy as np
import pytest
from scipy.stats import chi2

from ltv_mpc.localisation.filter.error_state_filter import Innovations
from ltv_mpc.localisation.health import FALSE_ALARM, HealthMonitor, band, filter_status, innovation_statistics
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import FilterStatus, SensorReport, SensorStatus

SUITE = SensorConfig.load("realistic")
GATE = 0.999
SECOND = 1_000_000_000
PERIODS = {"adcp": 333_333_333, "pressure": 100_000_000, "compass": SECOND}
ROWS = {"adcp": 60, "pressure": 1, "compass": 1}


def hear(monitor, rng, seconds, sensor, scale=1.0, outliers=0.0, start_s=0.0):
    """Feed ``seconds`` of one sensor's innovations, ``scale`` times as large as the filter expects."""
    limit = chi2.ppf(GATE, 1)
    for t in np.arange(start_s * SECOND + PERIODS[sensor], (start_s + seconds) * SECOND + 1, PERIODS[sensor]):
        m = ROWS[sensor]
        S = np.diag(rng.uniform(0.5, 2.0, m))
        r = scale * np.sqrt(np.diagonal(S)) * rng.standard_normal(m)
        r[rng.random(m) < outliers] += 50.0
        monitor.observe(Innovations(sensor, int(t), np.arange(m), r, S, r**2 / np.diagonal(S) <= limit))


def reports(monitor, t_s, account=()):
    return {r.sensor: r for r in monitor.sensors(int(t_s * SECOND), dict(account))}


def nominal(rng, seconds=12.0, **wrong):
    monitor = HealthMonitor(SUITE, GATE)
    for sensor in PERIODS:
        hear(monitor, rng, seconds, sensor, **wrong.get(sensor, {}))
    return monitor


def test_sensors_as_their_file_says_are_ok_and_so_is_the_filter():
    for seed in range(20):
        said = reports(nominal(np.random.default_rng(seed)), 12.0)
        assert {said[name].status for name in PERIODS} == {SensorStatus.OK}
        assert filter_status(tuple(said.values())) == (FilterStatus.NOMINAL, "")


def test_the_mean_of_the_accepted_rows_is_one_for_any_gate():
    """1.3 % too small without the correction for the gate: 12,000 rows have a mean good to 1.3 % (1 sigma)."""
    means = [reports(nominal(np.random.default_rng(seed)), 12.0)["adcp"].nis for seed in range(60)]
    assert np.mean(means) == pytest.approx(1.0, abs=4 * np.sqrt(2 / (60 * 30 * 60)))


def test_outliers_are_rejected_and_do_not_make_the_sensor_inconsistent():
    monitor = nominal(np.random.default_rng(1), adcp={"outliers": 0.05})
    said = reports(monitor, 12.0)["adcp"]
    assert said.status is SensorStatus.OK
    assert said.nis == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(("scale", "sensor"), [(2.2, "adcp"), (1.15, "adcp"), (0.3, "adcp"), (2.2, "pressure")])
def test_innovations_larger_or_smaller_than_expected_make_a_sensor_inconsistent(scale, sensor):
    said = reports(nominal(np.random.default_rng(2), **{sensor: {"scale": scale}}), 12.0)
    assert said[sensor].status is SensorStatus.INCONSISTENT
    others = {r.status for name, r in said.items() if name in PERIODS and name != sensor}
    assert others == {SensorStatus.OK}


def test_a_sensor_that_mostly_fails_the_gate_is_rejected_the_profiler_with_filter():
    said = reports(nominal(np.random.default_rng(3), adcp={"scale": 20.0}), 12.0)
    assert said["adcp"].status is SensorStatus.REJECTED
    status, why = filter_status(tuple(said.values()))
    assert status is FilterStatus.INCONSISTENT
    assert "adcp: more than half of its measurements fail the gate" in why


def test_one_rejected_sensor_is_a_sensor_fault_and_two_are_a_filter_fault():
    one = nominal(np.random.default_rng(4), compass={"scale": 20.0})
    said = reports(one, 12.0)
    assert said["compass"].status is SensorStatus.REJECTED
    assert filter_status(tuple(said.values()))[0] is FilterStatus.NOMINAL
    two = nominal(np.random.default_rng(4), compass={"scale": 20.0}, pressure={"scale": 20.0})
    assert filter_status(tuple(reports(two, 12.0).values()))[0] is FilterStatus.INCONSISTENT


def test_a_sensor_is_silent_after_three_periods_but_not_satellites_under_water():
    monitor = nominal(np.random.default_rng(5))
    assert reports(monitor, 12.9)["adcp"].status is SensorStatus.OK
    said = reports(monitor, 13.1)
    assert said["adcp"].status is SensorStatus.SILENT
    assert said["adcp"].last_t_ns == 36 * 333_333_333
    assert said["compass"].status is SensorStatus.OK
    assert said["gnss"].status is said["tdcp"].status is SensorStatus.OK
    assert reports(HealthMonitor(SUITE, GATE), -1.0)["gnss"].status is SensorStatus.SILENT


def test_innovations_older_than_the_window_do_not_count():
    rng = np.random.default_rng(6)
    monitor = HealthMonitor(SUITE, GATE)
    hear(monitor, rng, 6.0, "adcp", scale=20.0)
    hear(monitor, rng, 4.0, "adcp", start_s=6.0)
    assert reports(monitor, 10.0)["adcp"].status is SensorStatus.REJECTED
    hear(monitor, rng, 6.5, "adcp", start_s=10.0)
    assert reports(monitor, 16.5)["adcp"].status is SensorStatus.OK
    monitor.reset()
    assert reports(monitor, 16.6)["adcp"].nis is None


def test_counts_are_those_since_the_last_report_with_the_reason():
    monitor = HealthMonitor(SUITE, GATE)
    account = {
        "adcp.used": 100,
        "adcp.gate": 3,
        "adcp.late_applied": 1,
        "adcp.deweighted": 2,
        "pressure.used": 9,
        "adcp_like.gate": 5,
    }
    first = reports(monitor, 1.0, account.items())["adcp"]
    assert (first.used, first.rejected) == (100, {"gate": 3})
    account |= {"adcp.used": 150, "adcp.no_return": 7}
    second = reports(monitor, 2.0, account.items())["adcp"]
    assert (second.used, second.rejected) == (50, {"no_return": 7})


def test_the_false_alarm_rate_of_a_good_sensor_is_about_one_in_a_million():
    low, high = band(30)
    draws = chi2.rvs(30, size=2_000_000, random_state=7) / 30
    assert np.count_nonzero(draws > high) <= 10
    assert np.count_nonzero(draws < low) <= 10
    assert chi2.sf(30 * high, 30) == pytest.approx(FALSE_ALARM)
    assert chi2.cdf(30 * low, 30) == pytest.approx(FALSE_ALARM)


def test_rows_that_share_an_error_count_as_fewer_independent_ones():
    """Fifty rows with a correlation of 0.7: the mean square of a window strays more than that of 1500, and is right."""
    rng = np.random.default_rng(8)
    m, rho = 50, 0.7
    S = (1 - rho) * np.eye(m) + rho
    L = np.linalg.cholesky(S)
    nis = []
    for _ in range(200):
        monitor = HealthMonitor(SUITE, GATE)
        for k in range(30):
            r = L @ rng.standard_normal(m)
            t_ns = (k + 1) * 333_333_333
            monitor.observe(Innovations("adcp", t_ns, np.arange(m), r, S, np.abs(r) <= np.sqrt(chi2.ppf(GATE, 1))))
        said = reports(monitor, 10.0)["adcp"]
        assert said.status is SensorStatus.OK
        nis.append(said.nis)
    assert np.std(nis) == pytest.approx(np.sqrt(2 / (30 * m * m / np.sum(S**2))), rel=0.2)
    assert max(nis) > band(30 * m)[1]


def test_a_sensor_noisier_than_its_file_is_flagged_and_the_filter_is_not():
    said = reports(nominal(np.random.default_rng(9), adcp={"scale": 1.25}), 12.0)
    assert said["adcp"].status is SensorStatus.INCONSISTENT
    assert filter_status(tuple(said.values())) == (FilterStatus.NOMINAL, "")


def test_a_sensor_that_the_vehicle_lacks_is_not_reported():
    names = {r.sensor for r in HealthMonitor(SUITE, GATE).sensors(0, {})}
    assert names == {"gnss", "tdcp", "adcp", "pressure", "compass"}
    assert all(isinstance(r, SensorReport) for r in HealthMonitor(SUITE, GATE).sensors(0, {}))


def test_rows_count_as_often_as_they_are_independent():
    """Squared correlations of those that passed, of unlike variances; what was refused is not looked at."""
    rng = np.random.default_rng(4)
    root = rng.standard_normal((12, 3))
    S = root @ root.T + np.diag(rng.uniform(0.1, 9.0, 12))
    residual, accepted = rng.standard_normal(12), np.arange(12) != 5
    passed, squares, pairs = innovation_statistics(residual, S, accepted)
    variance = np.diag(S)[accepted]
    assert passed == 11
    assert squares == pytest.approx(np.sum(residual[accepted] ** 2 / variance))
    assert pairs == pytest.approx(np.sum(S[np.ix_(accepted, accepted)] ** 2 / np.outer(variance, variance)))
    S[5, :] = S[:, 5] = np.nan
    assert innovation_statistics(residual, S, accepted) == (passed, squares, pairs)
