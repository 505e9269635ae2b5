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


def checked(*of, seconds: int = 20) -> VehicleFileCheck:
    """Return the check after some seconds with one fit."""
    check = VehicleFileCheck()
    for t in range(seconds + 1):
        check.update(t * S, fit(*of))
    return check


@pytest.mark.parametrize(
    ("arm_m", "named"), [((0.5, 0.0), "0.5 m ahead and 0.0 m"), ((0.3, -0.4), "0.3 m ahead and 0.4 m to port")]
)
def test_a_long_arm_is_named(arm_m, named):
    check = checked(arm_m)
    assert check.health.health == "degraded"
    assert named in check.why
    assert check.health.why in check.why


@pytest.mark.parametrize(
    ("factors", "named"),
    [
        ({0: 2.0}, "mass ahead looks 2 of"),
        ({3: 0.5}, "drag ahead looks 0.5 of"),
        ({5: 1.5}, "drag in yaw looks 1.5 of"),
        ({0: 2.0, 2: 2.0, 3: 2.0}, "thrust looks 0.5 of"),
    ],
)
def test_a_wrong_factor_is_named_and_only_it(factors, named):
    check = checked((0.0, 0.0), factors)
    assert check.health.health == "degraded"
    assert named in check.why
    assert check.why.count("looks") == 1


@pytest.mark.parametrize(
    "small",
    [
        checked((0.2, 0.1)),
        checked((0.5, 0.0), seconds=9),
        checked((0.0, 0.0), {3: 1.35}),
        checked((0.0, 0.0), {2: 1.4}),
        checked((0.0, 0.0), {1: 2.0, 4: 0.4}),  # abeam, where a hull seldom moves
        checked((0.0, 0.0), {3: 0.5}, seconds=9),
        checked((0.0, 0.0), {}, 0.1),
    ],
)
def test_a_small_and_a_new_error_and_those_abeam_are_not_named(small: VehicleFileCheck):
    assert small.health.health == "nominal"
    assert small.why == ""


def test_a_learned_current_that_stays_at_its_bound_is_named():
    check = VehicleFileCheck()
    for t in range(16):
        assert check.health.health == ("nominal" if t <= 10 else "degraded")
        check.update(t * S, fit(), bounded=True)
    assert "current is at its bound" in check.why


def test_late_stamps_are_named_with_the_delay_and_nothing_that_they_explain():
    check = VehicleFileCheck()
    for t in range(11):
        assert check.health.health == "nominal"
        assert not check.stamps_are_late
        check.update(t * S, fit((0.5, 0.0), {0: 2.0}, 0.5 + 0.01 * t))
    assert check.health.health == "degraded"
    assert check.stamps_are_late
    for text in (check.why, check.health.why):
        assert "older than their stamps by about 0.5 s: stamp each with the time" in text
        assert "mass" not in text
        assert "reference_point" not in text
        assert "thrusters" not in text


def test_while_waves_carry_the_vehicle_late_stamps_are_named_and_the_file_is_not():
    wrong, late = VehicleFileCheck(), VehicleFileCheck()
    for t in range(21):
        wrong.update(t * S, fit((0.5, 0.0), {0: 2.0}), in_waves=True)
        late.update(t * S, fit(late_s=0.5), in_waves=True)
    assert wrong.why == ""
    assert late.stamps_are_late


def test_without_reports_late_stamps_or_thrusters_that_answer_late_are_named():
    check = VehicleFileCheck()
    for t in range(11):
        check.update(t * S, fit(late_s=0.5, reports=False))
    assert "or the thrusters answer so much later than lag_s says" in check.health.why


def test_the_alarm_ends_with_its_cause():
    check = checked((0.5, 0.0), {0: 2.0})
    assert check.health.why.count(";") == 1
    check.update(21 * S, fit((0.1, 0.0)))
    assert check.health.health == "nominal"
