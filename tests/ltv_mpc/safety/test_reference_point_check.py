"""Reference point check: an arm that is long, certain and lasts is named, others are not."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.safety.reference_point_check import ReferencePointCheck

S = 1_000_000_000


def checked(arm_m: tuple[float, float], sd_m: float = 0.02, seconds: int = 20) -> ReferencePointCheck:
    """Return the check after some seconds with one belief."""
    check = ReferencePointCheck()
    for t in range(seconds + 1):
        check.update(t * S, np.array(arm_m), sd_m**2 * np.eye(2))
    return check


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
    "uncertain", [checked((0.2, 0.1)), checked((0.5, 0.0), sd_m=0.17), checked((0.5, 0.0), seconds=14)]
)
def test_a_short_an_uncertain_and_a_new_arm_are_not(uncertain: ReferencePointCheck):
    assert uncertain.health.health == "nominal"
    assert uncertain.why == ""


def test_the_alarm_ends_with_its_cause():
    check = checked((0.5, 0.0))
    check.update(21 * S, np.array((0.1, 0.0)), 1e-4 * np.eye(2))
    assert check.health.health == "nominal"
