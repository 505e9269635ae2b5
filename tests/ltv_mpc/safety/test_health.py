"""Health thresholds by the ages of inputs."""

from __future__ import annotations

import pytest

from ltv_mpc import config
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.errors import ConfigError
from ltv_mpc.safety.health import NOMINAL, WORST_FIRST, Ages, HealthState, health, report_health, worst

MS = 1_000_000


@pytest.mark.parametrize(
    ("age_ms", "period_ms", "word"),
    [
        (None, 100, "degraded"),
        (0, 0, "nominal"),
        # a publisher at 10 Hz: 0.5, 10, 20 s, to the nanosecond
        (500, 100, "nominal"),
        (500.000001, 100, "degraded"),
        (10_000.000001, 100, "hold"),
        (20_000.000001, 100, "failsafe"),
        # slower ones: 3, 4, 6 periods
        (15_000, 5000, "nominal"),
        (15_000.000001, 5000, "degraded"),
        (20_000.000001, 5000, "hold"),
        (30_000.000001, 5000, "failsafe"),
        # stamps from the future
        (-500, 100, "nominal"),
        (-500.000001, 100, "degraded"),
        (-1000.000001, 100, "failsafe"),
    ],
)
def test_each_threshold_is_the_larger_of_its_seconds_and_its_periods(age_ms, period_ms, word):
    age_ns = None if age_ms is None else round(age_ms * MS)
    state = health(age_ns=age_ns, period_ns=period_ms * MS)
    assert state.health == word
    assert (state.why == "") == (word == "nominal")


def test_missing_reports_degrade_only_after_a_first_one():
    assert report_health(silent_ns=None, period_ns=0) is NOMINAL
    assert report_health(silent_ns=500 * MS, period_ns=100 * MS) is NOMINAL
    assert report_health(silent_ns=500 * MS + 1, period_ns=100 * MS).health == "degraded"
    assert report_health(silent_ns=2000 * MS, period_ns=1000 * MS) is NOMINAL


def test_the_worst_of_several_counts():
    states = [HealthState(word, f"reason {k}") for k, word in enumerate(WORST_FIRST)]
    for k, state in enumerate(states):
        assert worst(*reversed(states[k:])) is state
    assert worst(states[1], HealthState(states[1].health, "another reason")) is states[1]


@pytest.mark.parametrize(
    ("table", "field"),
    [
        ({"degraded_s": 12.0}, "hold_s"),
        ({"hold_s": 25.0}, "failsafe_s"),
        ({"hold_growth_m": 0.0}, "hold_growth_m"),
        ({"failsafe_s": 61.0}, "failsafe_s"),
    ],
)
def test_thresholds_that_contradict_each_other_are_rejected_by_name(table, field):
    with pytest.raises(ConfigError, match=field):
        config.parse({"ages": table}, ControllerConfig, source="settings")
    assert Ages(degraded_s=0.2, hold_s=0.2, failsafe_s=0.2).hold_s == 0.2
