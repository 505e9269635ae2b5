"""Vehicle files: contradictions are rejected when the file is read."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from ltv_mpc import Controller, Estimate, Vehicle, advance, references
from ltv_mpc.errors import ConfigError
from ltv_mpc.safety.plan_gate import PlanGate
from ltv_mpc.vehicle.flow import advance_heave

PAPER = Path(__file__).resolve().parents[3] / "ltv_mpc" / "vehicle" / "files" / "paper.toml"


def written(folder: Path, *changes: tuple[str, str]) -> str:
    """Write the paper's vehicle with changed lines to a file."""
    text = PAPER.read_text()
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    (folder / "mine.toml").write_text(text)
    return str(folder / "mine.toml")


@pytest.mark.parametrize("thrust", ["62.6", "-62.6"])
def test_a_failsafe_outside_the_vertical_thrusters_box_is_rejected(thrust, tmp_path):
    """Otherwise the plans of the last fallback level would be outside the box, and the actuators would reject them."""
    path = written(tmp_path, ("failsafe_vertical_N = 0.0", f"failsafe_vertical_N = {thrust}"))
    with pytest.raises(ConfigError, match=rf"mine.toml.*failsafe_vertical_N = {thrust}.*max_N = 62.5"):
        Vehicle.load(path)


def test_two_thrusters_on_the_centre_line_are_rejected(tmp_path):
    path = written(tmp_path, ("arm_m = 0.2 ", "arm_m = 0.0 "))
    with pytest.raises(ConfigError, match=r"mine.toml.*arm_m"):
        Vehicle.load(path)


def test_one_thruster_off_the_centre_line_is_enough(tmp_path):
    path = written(tmp_path, ("arm_m = 0.2                    # m left", "arm_m = 0.0                    # m left"))
    assert Vehicle.load(path).thruster.port.arm_m == 0.0


SURFACE = PAPER.with_name("surface.toml").read_text()
VERTICAL = "[thruster.vertical]" + PAPER.read_text().partition("[thruster.vertical]")[2]
HEAVE = "[heave]" + PAPER.read_text().partition("[heave]")[2].partition("[yaw]")[0]


@pytest.mark.parametrize(
    ("more", "missing", "there"), [(VERTICAL, "heave", "thruster.vertical"), (HEAVE, "thruster.vertical", "heave")]
)
def test_heave_without_vertical_thruster_or_the_reverse_is_rejected(more, missing, there, tmp_path):
    (tmp_path / "mine.toml").write_text(SURFACE + more)
    with pytest.raises(ConfigError, match=rf"mine.toml.*\[{missing}\] is missing but \[{there}\] is present"):
        Vehicle.load(str(tmp_path / "mine.toml"))


def test_a_surface_craft_with_net_buoyancy_is_rejected(tmp_path):
    (tmp_path / "mine.toml").write_text(SURFACE.replace("[surge]", "net_buoyancy_N = 3.0\n[surge]", 1))
    with pytest.raises(ConfigError, match=r"net_buoyancy_N = 3.0: must be 0 or left out without \[heave\]"):
        Vehicle.load(str(tmp_path / "mine.toml"))


def test_a_surface_craft_plans_no_vertical_thrust_and_needs_no_depth():
    """Even a reference with a depth does not change that."""
    craft = Vehicle.load("surface")
    assert not craft.can_dive
    assert Vehicle.load("paper").can_dive
    controller = Controller(craft, references.Point(north_m=0.0, east_m=0.0, depth_m=40.0))
    estimate = Estimate.at_rest(north_m=1.0)
    for _ in range(10):
        plan = controller.plan(estimate)
        assert plan.origin == "solved"
        assert (plan.thrust_N[:, 2] == 0.0).all()
        estimate = advance(craft, estimate, plan, duration_s=0.3)
        assert estimate.depth_m is None
    assert estimate.north_m < 0.9


def test_a_surface_craft_stays_at_the_surface_in_the_simulation():
    craft = Vehicle.load("surface")
    p = craft.coefficients()
    assert advance_heave(0.0, 0.0, 0.0, 0.0, 0.0, 10.0, p) == (0.0, 0.0, 0.0)
    plan = PlanGate(craft).command_at(0)
    assert plan == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ["low-yaw", "weak-reverse"])
def test_the_papers_variants_differ_only_in_the_stated_values(name):
    paper, other = (tomllib.loads(PAPER.with_name(f"{x}.toml").read_text()) for x in ("paper", name))
    key = {"low-yaw": "arm_m", "weak-reverse": "min_N"}[name]
    for side in ("port", "starboard"):
        assert other["thruster"][side].pop(key) == pytest.approx(paper["thruster"][side].pop(key) / 4, rel=2e-3)
    for table in (paper, other):
        del table["name"], table["description"]
    assert other == paper
