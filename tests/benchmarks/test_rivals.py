"""Rivals of the controller: each must fly well, or the comparison proves nothing."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from benchmarks.loop import run_config
from benchmarks.rivals import law, lqr, mpc, pid
from ltv_mpc.messages import CurrentProfile, Estimate
from ltv_mpc.vehicle.parameters import Vehicle

GAINS = {"kp": 200.0, "kd": 600.0, "ki": 5.0, "k_psi": 100.0, "k_r": 200.0, "hold_N": 2.0}
WEIGHTS = {
    "thrust": 1e-2,
    "velocity": 1.0,
    "heading": 1e-2,
    "yaw_rate": 0.1,
    "sway_mps": 0.03,
    "least_mps": 0.02,
    "most_m": 0.3,
}
SETTINGS = ("run.seed=400", "run.duration_s=40.0")


@pytest.fixture(scope="module")
def uncontrolled_m() -> float:
    return law.fly(run_config(*SETTINGS), law.Nothing()).mean_m


def test_pid_and_lqr_hold_the_vehicle_that_is_carried_away_without_them(uncontrolled_m: float) -> None:
    here = run_config(*SETTINGS)
    by_pid = law.fly(here, pid.Pid(here.vehicle, GAINS))
    by_lqr = law.fly(here, lqr.Lqr(here.vehicle, WEIGHTS))
    assert by_pid.mean_m < 0.2 * uncontrolled_m
    assert by_lqr.mean_m < 0.5 * uncontrolled_m
    assert max(by_pid.mean_abs_N, by_lqr.mean_abs_N) <= 62.5


def test_a_plan_that_comes_late_and_was_made_for_earlier_costs_distance() -> None:
    means = []
    for compensates in (True, False):
        variant = mpc.Variant(delay_s=0.71, compensates=compensates)
        means.append(mpc.fly(run_config(*SETTINGS, *variant.settings), variant).mean_m)
    assert means[1] > 2.0 * means[0]


def test_the_gain_is_stable_at_every_speed_of_the_water_and_does_nothing_at_the_trim() -> None:
    vehicle = Vehicle.load("paper")
    made = lqr.Lqr(vehicle, WEIGHTS)
    still = Estimate.at_rest(heading_rad=math.pi, depth_m=1.0)
    current = CurrentProfile(depth_m=np.array([0.0, 2.0]), north_mps=np.full(2, 0.1), east_mps=np.zeros(2))
    pair = made.thrust(msgspec.structs.replace(still, current=current), (0.0, 0.0))
    assert pair == pytest.approx((0.5 * 500.0 * 0.1**2,) * 2, abs=1e-9)  # head into the current, against the drag
    north = made.thrust(msgspec.structs.replace(still, current=current), (-0.1, 0.0))
    assert min(north) > max(pair)  # the target is ahead
