"""LQR of the comparison; flights of it and of PID are in test_robustness.py."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from benchmarks.rivals import lqr
from ltv_mpc.messages import CurrentProfile, Estimate
from ltv_mpc.vehicle.parameters import Vehicle

WEIGHTS = {
    "thrust": 1e-2,
    "velocity": 1.0,
    "heading": 1e-2,
    "yaw_rate": 0.1,
    "sway_mps": 0.03,
    "least_mps": 0.02,
    "most_m": 0.3,
}


def test_the_gain_is_stable_at_every_speed_of_the_water_and_does_nothing_at_the_trim() -> None:
    vehicle = Vehicle.load("paper")
    made = lqr.Lqr(vehicle, WEIGHTS)
    still = Estimate.at_rest(heading_rad=math.pi, depth_m=1.0)
    current = CurrentProfile(depth_m=np.array([0.0, 2.0]), north_mps=np.full(2, 0.1), east_mps=np.zeros(2))
    pair = made.thrust(msgspec.structs.replace(still, current=current), (0.0, 0.0))
    assert pair == pytest.approx((0.5 * 500.0 * 0.1**2,) * 2, abs=1e-9)  # head into the current, against the drag
    north = made.thrust(msgspec.structs.replace(still, current=current), (-0.1, 0.0))
    assert min(north) > max(pair)  # the target is ahead
