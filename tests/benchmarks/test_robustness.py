"""Short form of ``python -m benchmarks.robustness``: some rows with limits, and the parts of the benchmark."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.robustness.cases import RIGHT, conditions
from benchmarks.robustness.flights import Job, Row, judged
from benchmarks.robustness.laws import DEFAULT
from benchmarks.strangers.flight import Conditions, fly, load

WORSE, SHARE = 1.3, {"hold": 1.0, "square": 0.65}
"""Factor on the measured error above which a row fails; share of a task that is flown: errors count until arrival."""

ROWS = {
    Row("light_boat", "square", RIGHT): 0.057,
    Row("light_boat", "square", "mass=2 drag=0.5 arm=0.7"): 0.100,
    Row("bluerobotics-boat", "square", "thrust=0.7"): 0.083,
    Row("bluerobotics-boat", "square", "wind=0.1"): 0.103,
    Row("bluerobotics-boat", "square", "waves_V=0.15"): 0.268,
    Row("bluerobotics-boat", "hold", "noise_m=0.3"): 0.064,
    Row("bluerobotics-boat", "hold", "dead_time_s=0.3"): 0.016,
}
"""Mean error (m) of the controller's default, from the table."""


class Ahead:
    """Pilot with a constant thrust."""

    cycle_steps, delay_steps, nominal = 10, 0, True

    def __init__(self, thrust_N: float) -> None:
        self._thrust = np.full((1, 2), thrust_N)

    def plan(self, estimate, t_ns, applied):
        del estimate, applied
        return np.array([t_ns]), self._thrust


def conditions_in_still_water(case: str) -> Conditions:
    hull = load("light_boat")[0]
    return Conditions(**{**vars(conditions(case, hull)), "current_mps": 0.0})


def speed_mps(case: str, at_s: float) -> float:
    """Return the speed of the light boat after some time of straight thrust; its drag ahead is quadratic."""
    flight = fly("light_boat", Ahead(10.0), conditions_in_still_water(case), duration_s=at_s)
    return float(np.hypot(*flight.track[-1, 3:5]))


@pytest.mark.parametrize(
    ("case", "ratio", "at_s"),
    [
        ("drag=0.5", math.sqrt(2.0), 30.0),
        ("thrust=0.7", math.sqrt(0.7), 30.0),
        ("mass=2", 1.0, 30.0),
        ("mass=2", 0.5, 0.5),
        ("dead_zone=0.3", 0.0, 30.0),
    ],
)
def test_a_case_changes_the_true_vehicle_by_its_factor(case: str, ratio: float, at_s: float) -> None:
    assert speed_mps(case, at_s) == pytest.approx(ratio * speed_mps(RIGHT, at_s), abs=0.02)


def test_waves_carry_the_plant() -> None:
    carried = fly("light_boat", Ahead(0.0), conditions_in_still_water("waves_V=0.15"), duration_s=8.0)
    speeds = np.hypot(*carried.track[:, 3:5].T)
    assert speeds.max() == pytest.approx(0.15 * load("light_boat")[0].top_speed_mps(), rel=0.02)


@pytest.mark.parametrize("row", ROWS, ids=" ".join)
def test_the_controller_is_no_more_than_30_percent_worse_than_it_was(row: Row) -> None:
    found = judged(Job(row, DEFAULT, 1, {}), SHARE[row.task])
    assert found.mean_m < WORSE * ROWS[row]
    assert math.isfinite(found.arrival_s)
