"""Short form of ``python -m benchmarks.robustness``: some rows with limits."""

from __future__ import annotations

import math

import pytest

from benchmarks.robustness.cases import RIGHT
from benchmarks.robustness.flights import Job, Row, judged
from benchmarks.robustness.laws import DEFAULT

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


@pytest.mark.parametrize("row", ROWS, ids=" ".join)
def test_the_controller_is_no_more_than_30_percent_worse_than_it_was(row: Row) -> None:
    found = judged(Job(row, DEFAULT, 1, {}), SHARE[row.task])
    assert found.mean_m < WORSE * ROWS[row]
    assert math.isfinite(found.arrival_s)
