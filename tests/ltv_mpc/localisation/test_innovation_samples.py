"""Samples of the innovations for the report: the newest of each sensor since the last one, of rows that passed."""

from itertools import pairwise

import msgspec
import numpy as np

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.error_state_filter import Innovations
from ltv_mpc.localisation.health import MAX_ROWS, InnovationSamples
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import LocalisationReport

SENSORS = SensorConfig.load("realistic")


def innovations(sensor, t_ns, residual, accepted=None, indices=None):
    """Row i has the standard deviation i + 1, and correlates with the others."""
    m = len(residual)
    sd = np.arange(1.0, m + 1)
    return Innovations(
        sensor=sensor,
        t_ns=t_ns,
        indices=np.arange(m) if indices is None else np.array(indices),
        residual=np.array(residual),
        S=np.outer(sd, sd) * (0.5 + 0.5 * np.eye(m)),
        accepted=np.ones(m, dtype=bool) if accepted is None else np.array(accepted),
    )


def test_of_each_sensor_the_newest_message_is_shown_once():
    samples = InnovationSamples()
    samples.observe(innovations("compass", 1, [0.1]))
    samples.observe(innovations("gnss", 1, [1.0, 2.0, 3.0, 4.0]))
    samples.observe(innovations("compass", 2, [0.2]))
    compass, gnss = samples.take()
    assert (compass.sensor, compass.t_ns, compass.innovations, compass.sd) == ("compass", 2, (0.2,), (1.0,))
    assert (gnss.rows, gnss.innovations, gnss.sd) == ((0, 1, 2, 3), (1.0, 2.0, 3.0, 4.0), (1.0, 2.0, 3.0, 4.0))
    assert samples.take() == ()


def test_rows_that_failed_the_gate_are_left_out_and_the_others_keep_their_index():
    samples = InnovationSamples()
    samples.observe(innovations("gnss", 1, [1.0, 90.0, 3.0, 4.0], [True, False, True, True]))
    samples.observe(innovations("compass", 1, [90.0], [False]))
    (gnss,) = samples.take()
    assert (gnss.rows, gnss.innovations, gnss.sd) == ((0, 2, 3), (1.0, 3.0, 4.0), (1.0, 3.0, 4.0))


def test_of_a_profiler_four_rows_at_equal_steps_are_shown():
    samples = InnovationSamples()
    samples.observe(innovations("adcp", 1, list(range(56)), indices=range(100, 156)))
    (adcp,) = samples.take()
    assert adcp.rows == (100, 114, 128, 142)
    assert adcp.innovations == (0.0, 14.0, 28.0, 42.0)
    for m in range(1, 60):
        samples.observe(innovations("adcp", 1, [0.0] * m))
        assert all(len(sample.rows) <= MAX_ROWS for sample in samples.take())


def test_each_transponder_counts_as_a_source():
    samples = InnovationSamples()
    for transponder in (0, 3):
        samples.observe(innovations("lbl", 1, [1.0 + transponder], indices=[transponder]))
    assert [(sample.rows, sample.innovations) for sample in samples.take()] == [((0,), (1.0,)), ((3,), (4.0,))]


def test_the_innovations_in_the_reports_of_a_filter_are_as_large_as_it_expects(make_dive, inbox_of):
    """Of 40 s of every sensor, 95 % lie within two standard deviations; and a report has none of an earlier one."""
    estimator = Estimator(SENSORS, msgspec.structs.replace(EstimatorConfig(), deepest_m=60.0, kept_m=0.0))
    dive = make_dive(SENSORS, 4, duration_s=40.0)
    out = [one for m in dive.messages for one in estimator.step(m.t_ns, inbox_of(m))]
    reports = [one for one in out if isinstance(one, LocalisationReport)]
    samples = [sample for report in reports for sample in report.innovations]
    assert {sample.sensor for sample in samples} >= {"gnss", "adcp", "pressure", "compass"}
    z = np.array([i / sd for sample in samples for i, sd in zip(sample.innovations, sample.sd, strict=True)])
    assert len(z) > 200
    assert 0.91 < np.mean(np.abs(z) < 2.0) < 0.99
    for earlier, later in pairwise(reports):
        assert all(sample.t_ns > earlier.t_ns - 1_000_000_000 for sample in later.innovations)
    assert len({(sample.sensor, sample.t_ns) for sample in samples}) == len(samples)
