"""Vehicle files: contradictions are rejected when the file is read."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from ltv_mpc import Vehicle
from ltv_mpc.errors import ConfigError

PAPER = Path(__file__).resolve().parents[3] / "ltv_mpc" / "vehicle" / "files" / "paper.toml"


TEXT, SURFACE = PAPER.read_text(), PAPER.with_name("surface.toml").read_text()
VERTICAL = "[thruster.vertical]" + TEXT.partition("[thruster.vertical]")[2]
HEAVE = "[heave]" + TEXT.partition("[heave]")[2].partition("[yaw]")[0]
FAILSAFE = "failsafe_vertical_N = "


@pytest.mark.parametrize(
    ("text", "says"),
    [
        # the plans of the last fallback level would be outside the box, and the actuators would reject them
        (TEXT.replace(f"{FAILSAFE}0.0", f"{FAILSAFE}62.6"), f"{FAILSAFE}62.6.*max_N = 62.5"),
        (TEXT.replace(f"{FAILSAFE}0.0", f"{FAILSAFE}-62.6"), f"{FAILSAFE}-62.6.*max_N = 62.5"),
        (TEXT.replace("arm_m = 0.2 ", "arm_m = 0.0 "), "arm_m: both are 0"),
        (TEXT.replace("torque_inflow_coefficient", "# ", 1), "give both, or leave both out"),
        (SURFACE + VERTICAL, r"\[heave\] is missing but \[thruster.vertical\] is present"),
        (SURFACE + HEAVE, r"\[thruster.vertical\] is missing but \[heave\] is present"),
        (SURFACE.replace("[surge]", "net_buoyancy_N = 3.0\n[surge]", 1), "net_buoyancy_N = 3.0: must be 0 or left out"),
    ],
)
def test_parameters_that_contradict_each_other_are_rejected(text, says, tmp_path):
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(ConfigError, match=rf"mine\.toml.*{says}"):
        Vehicle.load(str(tmp_path / "mine.toml"))


def test_one_thruster_off_the_centre_line_is_enough(tmp_path):
    (tmp_path / "mine.toml").write_text(TEXT.replace("arm_m = 0.2 ", "arm_m = 0.0 ", 1))
    assert Vehicle.load(str(tmp_path / "mine.toml")).thruster.port.arm_m == 0.0


@pytest.mark.parametrize("name", ["low-yaw", "weak-reverse"])
def test_the_papers_variants_differ_only_in_the_stated_values(name):
    paper, other = (tomllib.loads(PAPER.with_name(f"{x}.toml").read_text()) for x in ("paper", name))
    key = {"low-yaw": "arm_m", "weak-reverse": "min_N"}[name]
    for side in ("port", "starboard"):
        assert other["thruster"][side].pop(key) == pytest.approx(paper["thruster"][side].pop(key) / 4, rel=2e-3)
    for table in (paper, other):
        del table["name"], table["description"]
    assert other == paper
