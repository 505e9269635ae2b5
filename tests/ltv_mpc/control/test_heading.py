"""Heading at a point: free, fixed, or into the current; it is a cost, and the position comes first."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ltv_mpc import Controller, Estimate, Vehicle
from ltv_mpc.control.config import Weights
from ltv_mpc.control.ocp.assembly import cost
from ltv_mpc.references import Hold, Point, Reference
from tests.ltv_mpc.control.flights import at_rest, fly
from tests.ltv_mpc.control.problems import LIMITS, Form

PAPER = Vehicle.load("paper")
WEIGHTS = Weights(heading_per_rad2=0.3)


def held(reference: Reference, current: tuple[float, float] = (0.0, 0.0), cycles: int = 120) -> tuple[Estimate, float]:
    """Return the estimate after so many cycles at a point, and the heading that the last plan wants."""
    way, plans = fly(Controller(PAPER, reference), at_rest(*current), cycles)
    return way[-1], plans[-1].reference_heading_rad


def off(heading_rad: float, wanted_rad: float) -> float:
    """Return the angle between two headings (rad)."""
    return abs(math.remainder(heading_rad - wanted_rad, math.tau))


def distance(estimate: Estimate) -> float:
    """Return the distance from north = east = 0 (m)."""
    return math.hypot(estimate.north_m, estimate.east_m)


def test_a_fixed_heading_is_held_in_still_water():
    end, wanted = held(Hold(heading_deg=-170.0))
    assert wanted == math.radians(-170.0)
    assert off(end.heading_rad, wanted) < math.radians(5.0)
    assert distance(end) < 0.1


def test_into_the_current_is_against_its_direction():
    end, wanted = held(Hold(into_current=True), (0.0, 0.15))
    assert wanted == pytest.approx(-0.5 * math.pi)
    assert off(end.heading_rad, wanted) < math.radians(5.0)
    assert distance(end) < 0.1


def test_without_a_heading_it_is_free_and_costs_nothing():
    free, wanted = held(Hold())
    assert wanted is None
    assert free.heading_rad == pytest.approx(0.0, abs=1e-3)


def test_in_a_current_across_it_the_position_comes_first():
    """Towards east at 0.2 m/s; with its heading to the north, the vehicle would drift away."""
    end, wanted = held(Point(north_m=0.0, east_m=0.0, heading_deg=0.0), (0.0, 0.2))
    assert wanted == 0.0
    assert distance(end) < 0.6
    assert off(end.heading_rad, wanted) > math.radians(45.0)


def test_a_weak_current_keeps_the_heading_that_was_wanted_before():
    reference = Hold(into_current=True)
    assert reference.heading_in((0.001, 0.0), None) is None
    assert reference.heading_in((0.1, 0.1), None) == pytest.approx(-0.75 * math.pi)
    assert reference.heading_in((0.001, 0.0), 0.3) == 0.3
    assert reference.heading_in((math.nan, 0.0), 0.3) == 0.3


def test_two_headings_are_rejected():
    with pytest.raises(ValueError, match="heading_deg and into_current"):
        Hold(heading_deg=0.0, into_current=True)


def test_it_says_that_a_current_across_turns_it():
    assert any("heading_deg = 90" in note for note in Hold(heading_deg=90.0).notes(PAPER))
    assert not Hold(into_current=True).notes(PAPER)


def test_the_cost_of_a_heading_by_hand():
    """Three stages of lengths 1, 1, 2; 0.3 of the square of the angle, the short way round."""
    t = np.array([0.0, 1.0, 2.0, 4.0])
    X, U, C, target = np.zeros((4, 8)), np.zeros((4, 2)), np.zeros((4, 2)), np.zeros((4, 3))
    X[:, 4] = 0.0, 0.1, 3.0, -0.2
    target[:3, 2] = 0.0, -3.0, 2.0 * math.pi
    objective = Form(t, LIMITS, WEIGHTS).constants
    expected = 0.5 * 0.3 * (0.01 + (6.0 - 2.0 * math.pi) ** 2 + 2.0 * 0.04)
    assert cost(X, U, C, target, objective) == pytest.approx(expected)
