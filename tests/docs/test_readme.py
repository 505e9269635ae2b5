"""The loop in the README moves the vehicle to its point."""

from __future__ import annotations

import math

from tests.docs.pages import ROOT, blocks


def loop() -> str:
    (code,) = (block.text for block in blocks("README.md") if block.language == "python")
    return code


def test_the_loop_works_as_printed_and_brings_the_vehicle_to_its_point():
    names: dict[str, object] = {}
    exec(loop(), names)
    estimate = names["estimate"]
    assert math.hypot(estimate.north_m, estimate.east_m) < 0.1  # type: ignore[attr-defined]
    assert names["plan"].origin == "solved"  # type: ignore[attr-defined]


def test_the_loop_works_with_a_vehicle_file_of_one_s_own(tmp_path):
    own = (ROOT / "ltv_mpc" / "vehicle" / "files" / "paper.toml").read_text()
    for theirs, mine in (('name = "paper"', 'name = "mine"'), ("_kgpm = 500.0", "_kgpm = 400.0")):
        assert theirs in own
        own = own.replace(theirs, mine)
    (tmp_path / "my_auv.toml").write_text(own)
    names: dict[str, object] = {}
    exec(loop().replace('Vehicle.load("paper")', f'Vehicle.load("{tmp_path}/my_auv.toml")'), names)
    assert names["vehicle"].surge.quadratic_damping_kgpm == 400.0  # type: ignore[attr-defined]
    estimate = names["estimate"]
    assert math.hypot(estimate.north_m, estimate.east_m) < 0.1  # type: ignore[attr-defined]
