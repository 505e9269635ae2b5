"""Station keeping of strangers and of shipped vehicles: rows of ``python -m benchmarks.strangers hold``."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.strangers import hold
from benchmarks.strangers.flight import Conditions, Start, fly
from benchmarks.strangers.hold import Row

ROWS = [
    #   vehicle           ahead  aside  current reports    noise   start
    (Row("low-yaw",       0.25,  0.0,   0.05,   False),            1),
    (Row("ellipsoid",     0.0,   0.25,  0.0,    False),            0),
    (Row("light_boat",    0.0,   0.0,   0.0,    True,    0.3),     2),
]  # fmt: skip
"""Some of the worst rows of the matrix, and one with noise: they failed before the held point kept the direction of the
water, before the controller estimated lever arm and noise, or while the target turned with the hull.
"""


@pytest.mark.parametrize(("row", "seed"), ROWS)
def test_a_hull_rests_at_its_point_whatever_point_of_it_the_estimates_are_of(row: Row, seed: int) -> None:
    figures = hold.judge(row, seed)
    assert figures.share <= 1.0, figures


@pytest.mark.parametrize("row", hold.drawn_rows(1), ids=lambda row: row.vehicle)
def test_a_hull_drawn_at_random_rests_at_its_point_with_a_wrong_file(row: Row) -> None:
    figures = hold.judge(row, 0)
    assert figures.share <= 1.0, figures


def test_the_estimates_are_of_the_point_that_the_conditions_name() -> None:
    """A pilot that notes what it is told, on a hull that turns: the point moves as a point of a rigid body does."""

    class Listener:
        cycle_steps, delay_steps, nominal = 10, 0, True

        def __init__(self) -> None:
            self.heard: list[tuple[float, ...]] = []

        def plan(self, estimate, t_ns, applied):  # type: ignore[no-untyped-def]
            assert (applied is not None) == (t_ns < 2_000_000_000)
            e = estimate
            self.heard.append((t_ns, e.t_ns, e.north_m, e.east_m, e.velocity_north_mps, e.velocity_east_mps))
            return np.array([t_ns]), np.array([[20.0, -20.0]])

    pilot = Listener()
    conditions = Conditions(offset_m=(0.2, -0.1), latency_s=0.5, period_s=0.2, reports_s=2.0, current_mps=0.1)
    flight = fly("light_boat", pilot, conditions, Start(heading_rad=1.0), duration_s=6.0)
    told = np.array(pilot.heard)
    assert set(np.round((told[:, 0] - told[:, 1]) * 1e-9, 3)) <= {0.5, 0.6}
    at = (told[1:, 1] * 1e-7).round().astype(int) - 1
    late = at >= 0
    np.testing.assert_allclose(told[1:, 2:4][late], flight.point[at[late]], atol=1e-9)
    north, east = np.gradient(flight.point, 0.01, axis=0).T
    inside = at > 100
    np.testing.assert_allclose(told[1:, 4][inside], north[at[inside]], atol=2e-3)
    np.testing.assert_allclose(told[1:, 5][inside], east[at[inside]], atol=2e-3)
    assert flight.turned_deg(0.0, 6.0) > 60.0
