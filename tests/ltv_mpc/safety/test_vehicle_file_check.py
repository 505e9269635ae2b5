"""Vehicle file check: an error of the file that is large, certain and lasts is named, others are not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ltv_mpc.safety.vehicle_file_check import VehicleFileCheck

S = 1_000_000_000
RIGHT = np.zeros(8)


def checked(
    arm_m: tuple[float, float] = (0.0, 0.0), model=RIGHT, *, sd: float = 0.02, seconds: int = 20
) -> VehicleFileCheck:
    """Return the check after some seconds with one belief."""
    check = VehicleFileCheck()
    for t in range(seconds + 1):
        check.update(t * S, (np.array(arm_m), sd**2 * np.eye(2)), (model, sd**2 * np.eye(8)))
    return check


def factor(index: int, value: float):
    """Return a model with one factor other than 1."""
    model = np.zeros(8)
    model[index] = math.log(value)
    return model


@pytest.mark.parametrize(
    ("arm_m", "named"),
    [
        ((0.5, 0.0), "0.5 m ahead and 0.0 m"),
        ((-0.5, 0.0), "0.5 m astern and 0.0 m"),
        ((0.0, 0.5), "0.5 m to starboard"),
        ((0.3, -0.4), "0.3 m ahead and 0.4 m to port"),
    ],
)
def test_a_long_arm_is_named(arm_m, named):
    check = checked(arm_m)
    assert check.health.health == "degraded"
    assert named in check.why
    assert check.health.why in check.why


@pytest.mark.parametrize(
    ("model", "named"),
    [
        (factor(0, 2.0), "mass ahead looks 2 of"),
        (factor(2, 0.6), "moment of inertia looks 0.6 of"),
        (factor(3, 0.5), "drag ahead looks 0.5 of"),
        (factor(5, 1.5), "drag in yaw looks 1.5 of"),
    ],
)
def test_a_wrong_factor_is_named_and_only_it(model, named):
    check = checked(model=model)
    assert check.health.health == "degraded"
    assert named in check.why
    assert check.why.count("looks") == 1


@pytest.mark.parametrize(
    "uncertain",
    [
        checked((0.2, 0.1)),
        checked((0.5, 0.0), sd=0.17),
        checked((0.5, 0.0), seconds=14),
        checked(model=factor(3, 1.2)),
        checked(model=factor(3, 0.5), sd=0.28),
        checked(model=factor(3, 0.5), seconds=14),
    ],
)
def test_a_small_an_uncertain_and_a_new_error_are_not(uncertain: VehicleFileCheck):
    assert uncertain.health.health == "nominal"
    assert uncertain.why == ""


def test_a_model_that_is_wrong_as_a_whole_is_named_by_its_uncertain_factors():
    """Half the mass of `surface`, on a square: two standard deviations, and more abeam, where no name is given."""
    half = np.array([-0.28, -0.5, -0.12, -0.01, 0.28, -0.01, 0.04, 0.02])
    assert checked(model=half, sd=0.14).why.startswith("mass ahead looks 0.76")
    assert checked(model=np.where(np.arange(8) == 0, half, 0.0), sd=0.14).why == ""


def test_a_learned_current_that_stays_at_its_bound_is_named():
    check = VehicleFileCheck()
    for t in range(21):
        assert check.health.health == ("nominal" if t <= 15 else "degraded")
        check.update(t * S, (np.zeros(2), np.eye(2)), (RIGHT, np.eye(8)), bounded=True)
    assert "current is at its bound" in check.why


def test_late_stamps_are_named_with_the_delay_and_nothing_that_they_explain():
    check = VehicleFileCheck()
    for t in range(16):
        assert check.health.health == "nominal"
        assert not check.stamps_are_late
        check.update(t * S, (np.array((0.5, 0.0)), 1e-4 * np.eye(2)), (factor(0, 2.0), 1e-4 * np.eye(8)), late_s=0.5)
    assert check.health.health == "degraded"
    assert check.stamps_are_late
    for text in (check.why, check.health.why):
        assert "older than their stamps by about 0.5 s: stamp each with the time" in text
        assert "mass" not in text
        assert "reference_point" not in text


def test_the_alarm_ends_with_its_cause():
    check = checked((0.5, 0.0), factor(0, 2.0))
    assert check.health.why.count(";") == 1
    check.update(21 * S, (np.array((0.1, 0.0)), 1e-4 * np.eye(2)), (RIGHT, 1e-4 * np.eye(8)))
    assert check.health.health == "nominal"
