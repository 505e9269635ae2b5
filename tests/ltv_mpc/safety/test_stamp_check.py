"""Stamp check: a delay of the estimates is found whatever the vehicle is, and right stamps never look like one."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import Applied, Estimate
from ltv_mpc.safety.stamp_check import StampCheck
from ltv_mpc.vehicle.parameters import Vehicle

VEHICLE = Vehicle.load("bluerobotics-boat")
MAX_N = VEHICLE.thrusters[0].max_N
STEP_S = 0.01
REPORT = Applied(
    t_ns=0, thrust_N=(0.0, 0.0, 0.0), command_N=(0.0, 0.0, 0.0), command_slew_N_per_s=(0.0, 0.0, 0.0), plan_epoch=0,
    plan_sequence=-1, plan_cycle_t_ns=0, plan_received_t_ns=0, plan_late=False, plans_late=0, plans_rejected=0,
)  # fmt: skip


def ns(seconds: float) -> int:
    """Return a time in ns."""
    return round(seconds * 1e9)


def steered(seconds: float, *, mass_kg: float, drag_kgpm: float, port: float, seed: int = 3):
    """Return times, states (n', e', psi, r) over ground and thrusts of a boat that is not the vehicle, in a current.

    Each second both thrusters move towards other random thrusts; ``port`` is the share that port delivers.
    """
    rng = np.random.default_rng(seed)
    steps = round(seconds / STEP_S)
    knots = 0.6 * MAX_N * rng.uniform(-0.5, 1.0, (round(seconds) + 2, 2))
    t = STEP_S * np.arange(steps)
    thrust = np.stack([np.interp(t, np.arange(len(knots)), knots[:, i]) for i in range(2)], axis=1)
    u = v = psi = r = 0.0
    states = np.empty((steps, 4))
    for k in range(steps):
        states[k] = u * math.cos(psi) - v * math.sin(psi) + 0.2, u * math.sin(psi) + v * math.cos(psi) - 0.1, psi, r
        f1, f2 = thrust[k] * (port, 1.0)
        du = (f1 + f2 - drag_kgpm * abs(u) * u) / mass_kg + 1.4 * v * r
        dv = (-3.0 * drag_kgpm * abs(v) * v - 20.0 * v) / (1.4 * mass_kg) - u * r / 1.4
        dr = (0.3 * (f1 - f2) - 12.0 * r - 15.0 * abs(r) * r - 0.4 * mass_kg * u * v) / (0.2 * mass_kg)
        u, v, r, psi = u + STEP_S * du, v + STEP_S * dv, r + STEP_S * dr, psi + STEP_S * r
    return t, states, thrust


def checked(
    late_s: float = 0.0, jitter_s: float = 0.0, *, seconds: float = 90.0, noise: float = 0.0, reports: bool = True,
    mass_kg: float = 40.0, drag_kgpm: float = 30.0, port: float = 1.0,
) -> list[float]:  # fmt: skip
    """Return the delay after each estimate; the states are older than their stamps by ``late_s`` +- ``jitter_s``."""
    t, states, thrust = steered(seconds, mass_kg=mass_kg, drag_kgpm=drag_kgpm, port=port)
    rng, check, found = np.random.default_rng(4), StampCheck(VEHICLE), []
    for k in range(0, len(t), 30):
        if reports:
            check.add_report(msgspec.structs.replace(REPORT, t_ns=ns(t[k]), thrust_N=(*thrust[k].tolist(), 0.0)))
        shown = states[max(k - round((late_s + jitter_s * rng.uniform(-1.0, 1.0)) / STEP_S), 0)]
        north, east, psi, r = (shown + noise * rng.standard_normal(4) * (1.0, 1.0, 0.1, 0.3)).tolist()
        motion = {"velocity_north_mps": north, "velocity_east_mps": east, "heading_rad": psi, "yaw_rate_radps": r}
        check.update(msgspec.structs.replace(Estimate.at_rest(), t_ns=ns(t[k]), **motion), None)
        found.append(check.delay_s)
    return found


@pytest.mark.parametrize("late_s", [0.5, 0.75, 1.0])
@pytest.mark.parametrize("true", [{}, {"mass_kg": 80.0, "drag_kgpm": 15.0}, {"port": 0.5}])
def test_a_delay_is_found_within_30_s_whatever_the_vehicle_is(late_s, true):
    assert checked(late_s, seconds=30.0, **true)[-1] == pytest.approx(late_s, abs=0.1)


def test_a_delay_that_jumps_is_found_too():
    assert checked(0.5, 0.3)[-1] == pytest.approx(0.5, abs=0.21)


@pytest.mark.parametrize("true", [{}, {"mass_kg": 80.0, "drag_kgpm": 15.0}, {"port": 0.5}, {"noise": 0.03}])
def test_right_stamps_are_never_late(true):
    assert set(checked(**true)) == {0.0}


def test_a_small_delay_and_one_without_reports_or_motion_are_not_named():
    assert set(checked(0.08)) == {0.0}
    assert set(checked(0.5, reports=False)) == {0.0}
    resting, rng = StampCheck(VEHICLE), np.random.default_rng(5)
    for k in range(300):
        resting.add_report(
            msgspec.structs.replace(REPORT, t_ns=ns(0.3 * k), thrust_N=(*rng.uniform(0.0, 0.1, 2).tolist(), 0.0))
        )
        r, north = (0.02 * rng.standard_normal(2)).tolist()
        moved = msgspec.structs.replace(
            Estimate.at_rest(), t_ns=ns(0.3 * k), yaw_rate_radps=r, velocity_north_mps=north
        )
        resting.update(moved, None)
        assert resting.delay_s == 0.0


def test_the_delay_ends_after_the_stamps_are_mended():
    t, states, thrust = steered(300.0, mass_kg=40.0, drag_kgpm=30.0, port=1.0)
    check, found = StampCheck(VEHICLE), []
    for k in range(0, len(t), 30):
        check.add_report(msgspec.structs.replace(REPORT, t_ns=ns(t[k]), thrust_N=(*thrust[k].tolist(), 0.0)))
        north, east, psi, r = states[max(k - 50, 0) if t[k] < 60.0 else k].tolist()
        motion = {"velocity_north_mps": north, "velocity_east_mps": east, "heading_rad": psi, "yaw_rate_radps": r}
        check.update(msgspec.structs.replace(Estimate.at_rest(), t_ns=ns(t[k]), **motion), None)
        found.append(check.delay_s)
    assert found[190] == pytest.approx(0.5, abs=0.1)
    assert found[-1] == 0.0
