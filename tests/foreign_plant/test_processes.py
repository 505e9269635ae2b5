"""The foreign craft as a process of its own, with the controller as a user starts it."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest

from services.supervisor import loopback
from tests.foreign_plant.flight import HERE, HULL
from tests.foreign_plant.plant import SET_AT_S
from tests.system.alone import controller, started


@pytest.mark.timeout(400)
def test_it_holds_the_point_by_its_own_clock_which_is_set_back(tmp_path: Path) -> None:
    """Armed by message, in real time, its clock two hours ahead: within 0.3 m for 15 s from the step on."""
    (tmp_path / "point.toml").write_text('kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n')
    held = 0

    def has_held(line: str) -> bool:
        nonlocal held
        if line.startswith("{"):
            said = json.loads(line)
            off_m = math.hypot(said["north_m"], said["east_m"])
            if said["t_s"] >= SET_AT_S - 1.0:
                assert off_m <= 0.3, line
                assert said["authority"] == "controller"
                held += 1
        return held >= 15

    arguments = ("--vehicle", str(HULL), "--reference", str(tmp_path / "point.toml"))
    with (
        controller(loopback.free_port(), arguments) as (endpoint, console),
        started(sys.executable, "-P", str(HERE / "plant.py"), endpoint, "-5") as (_, plant),
    ):
        plant.until(has_held, within_s=240.0)
        console.until(lambda line: "was set by -" in line, within_s=5.0)
