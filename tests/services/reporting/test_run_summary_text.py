"""Summary text of a run: it names the reached speed if the machine was too slow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from services.reporting.run_summary_text import verdict

NOTHING = {"mean": None, "max": None, "final": None, "median": None, "p99": None}
THRUST = {"saturated_fraction": None, "max_abs_N": None, "mean_abs_N": None, "max_slew_N_per_s": None}
SUMMARY: dict[str, Any] = {
    "scenario": "descent",
    "mode": "services",
    "seed": 1,
    "speed": 10.0,
    "speed_reached": 9.6,
    "duration_s": 200.0,
    **dict.fromkeys(("tracking_error_m", "true_error_m", "localisation_error_m"), NOTHING),
    **{f"{name}_delay_{unit}": NOTHING for name in ("compute", "end_to_end") for unit in ("s", "wall_s")},
    "thrust": THRUST,
    "horizon_s": 13.8,
    "stages": 34,
    "cycles": 0,
    "plan_origin": {},
    "deadline_misses": 0,
    "plans_refused": 0,
    "restarts": 0,
    "messages": {"published": 0, "dropped": 0, "rejected": 0},
}


def test_the_energy_is_in_joules_and_without_torque_coefficients_relative() -> None:
    relative = THRUST | {"relative_power": 0.123}
    joules = relative | {"propulsive_energy_J": 4321.4, "lateral_energy_J": 210.6}
    with_file, without = (verdict(SUMMARY | {"thrust": thrust}, Path("x")) for thrust in (joules, relative))
    assert "4321 J (lateral thrusters 211 J), 12.3 % of full lateral power" in with_file
    assert "12.3 % of full lateral power; no torque coefficients given" in without


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({}, "200.0 s as processes at 10 x real time"),
        ({"speed_reached": 3.14}, "200.0 s as processes at 3.1 of 10 x real time"),
        ({"speed_reached": None}, "200.0 s as processes at 10 x real time"),
        ({"mode": "lockstep", "speed": None, "speed_reached": None}, "200.0 s in lock step"),
    ],
)
def test_the_first_line_says_how_the_run_went(changed: dict[str, Any], words: str) -> None:
    assert words in verdict(SUMMARY | changed, Path("somewhere")).splitlines()[0]
