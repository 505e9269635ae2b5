"""Scenarios of the foreign craft: each figure is within its limit."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.control.config import ControllerConfig, Disturbance
from tests.foreign_plant import scenarios
from tests.foreign_plant.flight import Flight, distance_m
from tests.foreign_plant.scenarios.clock_step import STEPS_S, drift_m, flown


@pytest.mark.parametrize("name", scenarios.NAMES)
def test_each_figure_is_within_its_limit(name: str) -> None:
    figures = scenarios.run(name)
    assert figures
    assert [figure for figure in figures if not figure.value <= figure.limit] == []


def test_without_an_estimate_of_the_current_it_would_hold_its_point_less_well() -> None:
    farthest_m = []
    for disturbance in (Disturbance(), Disturbance(sd_mps=0.0)):
        flight = Flight(config=ControllerConfig(disturbance=disturbance))
        flight.command(action="arm")
        flight.fly(40.0)
        farthest_m.append(distance_m(flight.fly(50.0)).max())
    assert farthest_m[1] > 2.0 * farthest_m[0], farthest_m


def _seconds_of(flight: Flight, health: str) -> float:
    return 0.3 * sum(plan.health == health for plan in flight.plans[66:])


@pytest.mark.parametrize("step_s", STEPS_S)
def test_two_way_a_step_of_the_clock_is_certain_and_degrades_for_a_second(step_s: float) -> None:
    flight = flown(step_s, reports=True)
    (clock_step,) = flight.clock_steps
    assert clock_step.certain
    assert clock_step.step_ns == pytest.approx(step_s * 1e9, abs=50_000_000)
    assert _seconds_of(flight, "failsafe") == _seconds_of(flight, "hold") == 0.0
    assert _seconds_of(flight, "degraded") <= 1.0
    assert drift_m(flight) < 0.3


SMALL_STEPS_S = (-0.2, -0.05, 0.05, 0.2)
"""Steps that are larger than the error of a short exchange, and smaller than a lateness that can count as a step."""


@pytest.mark.parametrize("step_s", SMALL_STEPS_S)
def test_two_way_a_step_above_the_reported_clock_error_is_recognised(step_s: float) -> None:
    flight = Flight(reports=True, delay_us=20_000)
    flight.command(action="arm")
    flight.fly(20.0)
    error_ns = flight.clock_offset.error_ns
    assert error_ns is not None
    assert error_ns < abs(step_s) * 1e9
    flight.set_clock(step_s)
    flight.fly(3.0)
    (clock_step,) = flight.clock_steps
    assert clock_step.certain
    assert clock_step.step_ns == pytest.approx(step_s * 1e9, abs=error_ns + 1_000_000)


@pytest.mark.parametrize("step_s", [step_s for step_s in SMALL_STEPS_S if step_s < 0.0])
def test_one_way_a_small_step_backwards_is_followed_and_moves_nothing(step_s: float) -> None:
    """Stamps that are later by a constant could be a slower link; the reported error is null. The offset follows."""
    flight = Flight(reports=False)
    flight.command(action="arm")
    flight.fly(20.0)
    flight.set_clock(step_s)
    flight.fly(35.0)
    assert flight.clock_offset.error_ns is None
    assert flight.clock_offset.offset_ns == pytest.approx(flight.craft_ns - flight.host_us * 1000, abs=1_000_000)
    assert drift_m(flight) < 0.05
    periods_s = np.diff([plan.cycle_t_ns for plan in flight.plans]) * 1e-9
    assert periods_s.min() >= 0.0  # vehicle time never steps back


@pytest.mark.parametrize("step_s", STEPS_S)
def test_one_way_a_step_backwards_is_doubtful_for_ten_seconds(step_s: float) -> None:
    flight = flown(step_s, reports=False)
    doubtful = -10.0 < step_s < -0.25
    assert [clock_step.certain for clock_step in flight.clock_steps] == ([] if step_s == -0.05 else [not doubtful])
    assert _seconds_of(flight, "failsafe") == _seconds_of(flight, "hold") == 0.0
    assert _seconds_of(flight, "degraded") == pytest.approx(10.5 if doubtful else 0.3, abs=0.8)
