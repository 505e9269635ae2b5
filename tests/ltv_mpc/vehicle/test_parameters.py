"""A vehicle file that contradicts itself is refused before anything starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltv_mpc import Vehicle
from ltv_mpc.errors import ConfigError

PAPER = Path(__file__).resolve().parents[3] / "ltv_mpc" / "vehicle" / "files" / "paper.toml"


def written(folder: Path, *changes: tuple[str, str]) -> str:
    """The paper's vehicle with lines changed, as a file."""
    text = PAPER.read_text()
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    (folder / "mine.toml").write_text(text)
    return str(folder / "mine.toml")


@pytest.mark.parametrize("thrust", ["62.6", "-62.6"])
def test_a_failsafe_that_the_vertical_thruster_cannot_give_is_refused(thrust, tmp_path):
    """Else the plans at the end of the ladder would be outside the box, and refused by the actuators."""
    path = written(tmp_path, ("failsafe_vertical_N = 0.0", f"failsafe_vertical_N = {thrust}"))
    with pytest.raises(ConfigError, match=rf"mine.toml.*failsafe_vertical_N = {thrust}.*max_N = 62.5"):
        Vehicle.load(path)


def test_two_thrusters_on_the_centre_line_turn_nothing_and_are_refused(tmp_path):
    path = written(tmp_path, ("arm_m = 0.2 ", "arm_m = 0.0 "))
    with pytest.raises(ConfigError, match=r"mine.toml.*arm_m"):
        Vehicle.load(path)


def test_one_thruster_off_the_centre_line_is_enough(tmp_path):
    path = written(tmp_path, ("arm_m = 0.2                    # m left", "arm_m = 0.0                    # m left"))
    assert Vehicle.load(path).thruster.port.arm_m == 0.0
