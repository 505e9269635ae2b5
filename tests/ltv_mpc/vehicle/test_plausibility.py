"""Plausibility: a wrong unit gives a warning that names the field; plausible vehicles give none."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from ltv_mpc import Vehicle
from ltv_mpc.vehicle import parameters
from ltv_mpc.vehicle.performance import performance
from ltv_mpc.vehicle.plausibility import warnings
from tests.ltv_mpc.control.test_scaling import scaled
from tests.ltv_mpc.vehicles import changed

FOLDER = Path(parameters.__file__).parent
PAPER = (FOLDER / "files" / "paper.toml").read_text()


def lines(first: str, count: int) -> str:
    """Lines of the paper's file from the one that contains ``first`` on."""
    rows = PAPER.splitlines(keepends=True)
    at = next(i for i, row in enumerate(rows) if first in row)
    return "".join(rows[at : at + count])


SURGE = lines("[surge]", 2)
SWAY = lines("quadratic_damping_kgpm = 800.0", 1)
"""Sway in the paper's file, which has quadratic damping only."""


OF_PAPER = performance(Vehicle.load("paper"))


def warnings_of(vehicle: Vehicle) -> list[str]:
    return warnings(vehicle, performance(vehicle))


def with_line(folder: Path, before: str, after: str) -> Vehicle:
    """Return the vehicle of the paper's file with another line."""
    assert before in PAPER
    (folder / "mine.toml").write_text(PAPER.replace(before, after, 1 if before == SWAY else -1))
    return Vehicle.load(str(folder / "mine.toml"))


def of_size(size: float) -> Vehicle:
    """Return the paper's vehicle that many times as long, and as fast as a hull of that length."""
    vehicle = scaled(Vehicle.load("paper"), size, math.sqrt(size), size**3)
    values = {"hull": parameters.Hull(length_m=2.0 * size, beam_m=0.65 * size)}
    for side, one in zip(("port", "starboard", "vertical"), vehicle.thrusters, strict=True):
        values[f"thruster.{side}.propeller_diameter_m"] = size * one.propeller_diameter_m
        values[f"thruster.{side}.max_rps"] = one.max_rps / math.sqrt(size)
    return changed(vehicle, values)


@pytest.mark.parametrize("name", [*sorted((FOLDER / "files").glob("*.toml")), FOLDER / "template.toml"])
def test_shipped_vehicles_and_the_template_give_no_warning(name: Path) -> None:
    assert warnings_of(Vehicle.load(str(name))) == []


def test_vehicles_from_30_kg_to_3_t_give_no_warning() -> None:
    sizes = np.cbrt(np.geomspace(30.0, 3000.0, 3) / 200.0).tolist()
    vehicles = [of_size(size) for size in sizes]
    assert {v.dry_mass_kg: warnings_of(v) for v in vehicles} == {v.dry_mass_kg: [] for v in vehicles}


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("dry_mass_kg = 200.0", "dry_mass_kg = 200000.0", "dry_mass_kg = 200000: 5 to 50000 kg are usual; is it in g"),
        ("dry_mass_kg = 200.0", "dry_mass_kg = 0.2", "dry_mass_kg = 0.2: 5 to 50000 kg are usual"),
        (SURGE, "[surge]\nmass_kg = 150.0\n", r"[surge] mass_kg = 150: 0.75 x dry_mass_kg"),
        ("inertia_kgm2 = 179.049", "inertia_kgm2 = 0.179", "[yaw] inertia_kgm2 = 0.179: a radius of gyration of"),
        ("inertia_kgm2 = 179.049", "inertia_kgm2 = 179049.0", "[yaw] inertia_kgm2 = 179049: a radius of gyration"),
        ("arm_m = 0.2 ", "arm_m = 0.0002 ", "[thruster.port] arm_m = 0.0002: 0.012 to 0.49 m fit 200 kg"),
        ("arm_m = 0.2 ", "arm_m = 20.0 ", "[thruster.starboard] arm_m = 20: 0.012 to 0.49 m fit 200 kg"),
        ("arm_m = 0.2 ", "arm_m = 0.656 ", "[thruster.port] arm_m = 0.656: 0.012 to 0.49 m fit 200 kg and the beam"),
        ("arm_m = 0.2                    # m left", "arm_m = 0.0 # m left", "[thruster.port] arm_m = 0: this"),
        ("[surge]", "[reference_point]\nforward_m = 50.0\n[surge]", "[reference_point] forward_m = 50: within 2.9 m"),
        ("max_N = 62.5 ", "max_N = 0.0625 ", "is the thrust in kN or gf"),
        ("max_N = 62.5 ", "max_N = 62500.0 ", "is the thrust in kN or gf"),
        ("min_N = -62.5                  # N; paper", "min_N = 0.0 # N; paper", "[thruster.port] min_N = 0: no"),
        ("min_N = -62.5 ", "min_N = -6.37 ", "[thruster.port] min_N of 6.37 and max_N = 62.5: 0.15 to 3 times"),
        ("beam_m = 0.65", "beam_m = 25.6", "[hull] beam_m = 25.6: wider than length_m"),
        ("lag_s = 0.3 ", "lag_s = 30.0 ", "[thruster.port] lag_s = 30"),
        (SWAY, "quadratic_damping_kgpm = 0.0\n", "[sway] both dampings are 0: a sideways drift never ends"),
        ("max_rps = 7.2 ", "max_rps = 432.0 ", "move at 339 m/s; is it in rev/min?"),
        ("propeller_diameter_m = 0.25 ", "propeller_diameter_m = 9.8 ", "at most 0.7 m fits 200 kg; is it in m?"),
        ("mass_kg = 500.0", "mass_kg = 1102.3", "are the masses in kg (not in pounds)"),
        ("net_buoyancy_N = 30.5", "net_buoyancy_N = 100.0", "cannot dive"),
        ("net_buoyancy_N = 30.5", "net_buoyancy_N = -100.0", "cannot rise"),
        ("net_buoyancy_N = 30.5", "net_buoyancy_N = -5.0", "without a plan the vehicle sinks"),
        ("linear_damping_Nms = 15.0", "linear_damping_Nms = 3000.0", "drag changes the motion within 0.06 s"),
    ],
)
def test_a_wrong_value_is_named(before: str, after: str, says: str, tmp_path: Path) -> None:
    sentences = warnings(with_line(tmp_path, before, after), OF_PAPER)
    assert any(says in sentence for sentence in sentences), sentences


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("max_rps = 7.2", "max_rps = 5.0", "[thruster.port] max_rps = 5: at the top speed of 0.5 m/s a propeller of"),
        ("max_N = 62.5 ", "max_N = 6.37 ", "is the thrust in N (not in kgf or lbf)?"),
        ("quadratic_damping_kgpm = 500.0", "quadratic_damping_kgpm = 500000.0", "top speed ahead 0.0158 m/s"),
        ("quadratic_damping_kgm2 = 200.0", "quadratic_damping_kgm2 = 200000.0", "a turn by 90 deg takes"),
    ],
)
def test_a_wrong_motion_is_named(before: str, after: str, says: str, tmp_path: Path) -> None:
    sentences = warnings_of(with_line(tmp_path, before, after))
    assert any(says in sentence for sentence in sentences), sentences


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [("max_rps", 432.0, "rev/min"), ("propeller_diameter_m", 9.8, "at most 0.7 m"), ("max_N", 6.37, "kgf or lbf")],
)
def test_a_wrong_value_of_the_vertical_thruster_alone_is_named(field: str, value: float, says: str) -> None:
    (sentence, *_) = warnings_of(changed(Vehicle.load("paper"), {f"thruster.vertical.{field}": value}))
    assert sentence.startswith(f"[thruster.vertical] {field} = {value:g}")
    assert says in sentence


def test_a_table_of_thrusts_in_kgf_as_of_a_data_sheet_is_named() -> None:
    boat = Vehicle.load("bluerobotics-boat")
    table = tuple(force_N / 9.81 for force_N in boat.thruster.port.pwm_N)
    (sentence,) = warnings_of(changed(boat, {"thruster.port.pwm_N": table}))
    assert sentence.startswith("[thruster.port] pwm_N of 5.249")


def test_the_arm_of_a_vehicle_without_a_hull_is_not_compared_with_a_beam() -> None:
    sentences = warnings(changed(Vehicle.load("paper"), {"thruster.port.arm_m": 20.0, "hull": None}), OF_PAPER)
    assert any(" m fit 200 kg; is it in m?" in sentence for sentence in sentences), sentences


def test_a_thruster_without_any_delay_gives_a_warning() -> None:
    prompt = changed(Vehicle.load("paper"), {"thruster.port.lag_s": 0.0, "thruster.port.slew_N_per_s": 1e5})
    assert any("full thrust in 0.62 ms" in one for one in warnings(prompt, OF_PAPER))
