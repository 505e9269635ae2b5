"""Fixed heading in a current: the extremes of the table in docs/notes/control-studies.md."""

from __future__ import annotations

import pytest

from benchmarks.fixed_heading import held
from ltv_mpc.vehicle.parameters import Vehicle

PAPER = Vehicle.load("paper")


@pytest.mark.parametrize("from_deg", [0.0, 180.0])
def test_a_current_along_the_heading_does_not_turn_the_vehicle(from_deg: float) -> None:
    result = held(PAPER, from_deg, 0.2)
    assert result.unsolved == 0
    assert result.bow_deg < 1.0
    assert result.position_m < 0.01


def test_in_a_weak_current_across_it_the_bow_swings_about_the_heading() -> None:
    result = held(PAPER, 90.0, 0.1)
    assert result.unsolved == 0
    assert abs(result.mean_bow_deg) < 2.0
    assert 20.0 < result.bow_deg < 30.0
    assert 0.2 < result.position_m < 0.3


@pytest.mark.parametrize("from_deg", [90.0, 270.0])
def test_in_a_stronger_current_bow_or_stern_turns_into_it(from_deg: float) -> None:
    result = held(PAPER, from_deg, 0.2)
    assert result.unsolved == 0
    assert 60.0 < abs(result.mean_bow_deg) < 75.0
    assert 75.0 < result.bow_deg < 90.0
    assert result.position_m < 0.3
