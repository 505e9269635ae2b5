"""Vehicle file check: an error of the file that is large, certain and lasts is named, others are not."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from ltv_mpc.safety.motion_fit import ARM, DELAY, MODEL, SIZE
from ltv_mpc.safety.vehicle_file_check import VehicleFileCheck

S = 1_000_000_000


def fit(arm_m=(0.0, 0.0), factors: dict[int, float] | None = None, late_s: float = 0.0, *, reports: bool = True):
    """Return a motion fit that is certain of a lever arm, of some factors by their index, and of a delay."""
    certain = np.zeros(SIZE)
    certain[ARM:MODEL], certain[DELAY] = arm_m, late_s
    for index, factor in (factors or {}).items():
        certain[MODEL + index] = math.log(factor)
    return SimpleNamespace(x=certain, certain=0.9 * certain, reported_ns=int(reports))


def checked(*of, seconds: int = 20, reports: bool = True, **options: bool) -> VehicleFileCheck:
    """Return the check after some seconds with one fit."""
    check = VehicleFileCheck(fit(*of, reports=reports))
    for t in range(seconds + 1):
        check.update(t * S, **options)
    return check


NO_ARM = (0.0, 0.0)


@pytest.mark.parametrize(
    ("arm_m", "factors", "named"),
    [
        ((0.5, 0.0), {}, "0.5 m ahead and 0.0 m"),
        ((0.3, -0.4), {}, "0.3 m ahead and 0.4 m to port"),
        (NO_ARM, {0: 2.0}, "mass ahead looks 2 of"),
        (NO_ARM, {3: 0.5}, "drag ahead looks 0.5 of"),
        (NO_ARM, {5: 1.5}, "drag in yaw looks 1.5 of"),
        (NO_ARM, {0: 2.0, 2: 2.0, 3: 2.0}, "thrust looks 0.5 of"),
    ],
)
def test_a_long_arm_or_a_wrong_factor_is_named_and_only_it(arm_m, factors, named):
    check = checked(arm_m, factors)
    assert check.health.health == "degraded"
    assert named in check.why
    assert check.why.count("looks") == bool(factors)
    assert factors or check.health.why in check.why


@pytest.mark.parametrize(
    "small",
    [
        checked((0.2, 0.1)),
        checked((0.5, 0.0), seconds=9),
        checked(NO_ARM, {3: 1.35}),
        checked(NO_ARM, {2: 1.4}),
        checked(NO_ARM, {1: 2.0, 4: 0.4}),  # abeam, where a hull seldom moves
        checked(NO_ARM, {3: 0.5}, seconds=9),
        checked(NO_ARM, {}, 0.1),
    ],
)
def test_a_small_and_a_new_error_and_those_abeam_are_not_named(small: VehicleFileCheck):
    assert small.health.health == "nominal"
    assert small.why == ""


def test_a_learned_current_that_stays_at_its_bound_is_named():
    assert checked(bounded=True, seconds=9).health.health == "nominal"
    check = checked(bounded=True, seconds=10)
    assert check.health.health == "degraded"
    assert "current is at its bound" in check.why


def test_late_stamps_are_named_with_the_delay_and_nothing_that_they_explain():
    check = VehicleFileCheck(fit())
    for t in range(11):
        assert check.health.health == "nominal"
        assert not check.late_s
        check.fit = fit((0.5, 0.0), {0: 2.0}, 0.5 + 0.01 * t)
        check.update(t * S)
    assert check.health.health == "degraded"
    assert check.late_s
    for text in (check.why, check.health.why):
        assert "older than their stamps by about 0.5 s: taken for that old; stamp each with the time" in text
        assert "mass" not in text
        assert "reference_point" not in text
        assert "thrusters" not in text


def test_the_named_delay_is_in_use_until_the_alarm_ends_also_while_a_slip_is_suspected():
    check = checked(NO_ARM, {}, 0.52)
    assert check.late_s == 0.5
    check._slips = SimpleNamespace(found="north and east are swapped")
    check.update(21 * S)
    assert check.late_s == 0.5
    check.update(31 * S)
    assert "north and east are swapped" in check.why
    assert check.late_s == 0.0


def test_while_waves_carry_the_vehicle_late_stamps_are_named_and_the_file_is_not():
    assert checked((0.5, 0.0), {0: 2.0}, other_cause=True).why == ""
    assert checked(NO_ARM, {}, 0.5, other_cause=True).late_s


def test_without_reports_late_stamps_or_thrusters_that_answer_late_are_named():
    check = checked(NO_ARM, {}, 0.5, seconds=10, reports=False)
    assert "or the thrusters answer so much later than lag_s says" in check.health.why


def test_the_alarm_ends_with_its_cause():
    check = checked((0.5, 0.0), {0: 2.0})
    assert check.health.why.count(";") == 1
    check.fit = fit((0.1, 0.0))
    check.update(21 * S)
    assert check.health.health == "nominal"
