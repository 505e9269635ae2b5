"""A campaign's file and the points that it means."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Vehicle
from services.tools.campaign.campaign import plan
from services.tools.campaign.file import Point, load, points
from services.tools.campaign.trial import Trial, run_config

GRID = """
title = "t"
[vary]
controller.horizon_s = [2.5, 5.1]
"water.sd_mps" = [0.02, 0.04, 0.08]
"""

SOBOL = """
title = "t"
[design]
kind = "sobol"
points = 64
seed = 3
[vary]
water.sd_mps = { low = 0.01, high = 0.09 }
water.correlation_length_m = { low = 1.0, high = 100.0, scale = "log" }
controller.max_stages = { low = 10, high = 40 }
sensors = ["paper", "realistic"]
"""


CROSSED = (
    SOBOL
    + """
size = { low = 0.5, high = 2.0, scale = "log" }
[cross]
controller.horizon_s = [2.5, 5.1]
reference.descent_rate_mps = [0.1, 0.2]
[scale.size]
vehicle.dry_mass_kg = 3
vehicle.thruster.port.arm_m = 1
"""
)


def written(folder: Path, text: str) -> Path:
    path = folder / "c.toml"
    path.write_text(text)
    return path


def test_a_grid_is_every_combination_with_the_last_key_running_fastest(tmp_path: Path) -> None:
    made = points(load(written(tmp_path, GRID)))
    assert [tuple(point.values()) for point in made] == [(h, sd) for h in (2.5, 5.1) for sd in (0.02, 0.04, 0.08)]
    assert list(made[0]) == ["controller.horizon_s", "water.sd_mps"]


def test_a_sobol_design_fills_each_range_evenly(tmp_path: Path) -> None:
    made = points(load(written(tmp_path, SOBOL)))
    assert len(made) == 64
    sd = np.sort([point["water.sd_mps"] for point in made])
    length = np.sort(np.log10([point["water.correlation_length_m"] for point in made]))
    # a power of two of scrambled points: one in each of as many equal parts
    np.testing.assert_array_equal(np.floor((sd - 0.01) / 0.08 * 64), np.arange(64))
    np.testing.assert_array_equal(np.floor(length / 2 * 64), np.arange(64))
    stages = [point["controller.max_stages"] for point in made]
    assert all(isinstance(n, int) and 10 <= n <= 40 for n in stages)
    assert [point["sensors"] for point in made].count("paper") == 32


def test_every_point_is_crossed_with_every_combination_of_the_crossed_lists(tmp_path: Path) -> None:
    made = points(load(written(tmp_path, CROSSED)))
    assert len(made) == 64 * 4
    crossed = [(point["controller.horizon_s"], point["reference.descent_rate_mps"]) for point in made[:4]]
    assert crossed == [(2.5, 0.1), (2.5, 0.2), (5.1, 0.1), (5.1, 0.2)]
    for one in range(0, len(made), 4):
        (size,) = {point["size"] for point in made[one : one + 4]}
        assert 0.5 <= float(size) <= 2.0
    assert len({point["size"] for point in made}) == 64


def test_a_factor_scales_what_a_point_has_otherwise_by_its_power(tmp_path: Path) -> None:
    text = CROSSED.replace("[cross]", "[set]\n'vehicle.thruster.port.arm_m' = 0.3\nvehicle = 'surface'\n[cross]")
    made = plan(load(written(tmp_path, text)), "test")
    point: Point = {"size": 2.0, "water.sd_mps": 0.05, "reference.descent_rate_mps": 0.1}
    assert made.campaign.factors(point) == {"vehicle.dry_mass_kg": 8.0, "vehicle.thruster.port.arm_m": 2.0}
    here = run_config(made.base, made.campaign, Trial(0, 3, point))
    assert here.vehicle.dry_mass_kg == 8.0 * Vehicle.load("surface").dry_mass_kg
    assert here.vehicle.thruster.port.arm_m == 0.6
    assert (here.scenario.water.sd_mps, here.scenario.run.seed) == (0.05, 3)
    assert here.reference.descent_rate_mps == 0.1
    of_water = msgspec.structs.replace(made.campaign, scale={"size": {"water.sd_mps": 1.0}})
    assert run_config(made.base, of_water, Trial(0, 0, point)).scenario.water.sd_mps == 0.1
    assert set(next(made.trials()).point) == set(made.campaign.varied)


def test_a_drawn_design_is_that_of_its_seed(tmp_path: Path) -> None:
    for text in (SOBOL, SOBOL.replace('"sobol"', '"random"')):
        first, again = (points(load(written(tmp_path, text))) for _ in range(2))
        other = points(load(written(tmp_path, text.replace("seed = 3", "seed = 4"))))
        assert first == again != other
        assert all(0.01 <= point["water.sd_mps"] <= 0.09 for point in first)


HORIZONS, LENGTHS = "controller.horizon_s = [2.5, 5.1]", "[0.02, 0.04, 0.08]"


@pytest.mark.parametrize(
    ("text", "old", "new", "problem"),
    [
        (GRID, "water.sd_mps", "water.sd", r'\[vary\] water.sd: unknown key; did you mean "water.sd_mps"'),
        (GRID, LENGTHS, "[0.02, 0.02]", r"\[vary\] water.sd_mps: must have at least one value, and none twice"),
        (GRID, LENGTHS, "[]", "must have at least one value"),
        (GRID, LENGTHS, "{ low = 1.0, high = 2.0 }", "must be a list of values where"),
        (GRID, "[vary]", 'minimise = "true_error"\n[vary]', "minimise.*must be a metric of summary.json"),
        (GRID, "[vary]", "seeds.count = 5_000_000\n[vary]", r"\[seeds\] count = 5000000: must be"),
        (GRID, "[vary]", "seeds.count = 1_000_000\n[cross]\nrun.duration_s = [1, 2]\n[vary]", "12 points .*at most"),
        (CROSSED, "points = 64", "points = 1_000_000", "4000000 points times 10 seeds: at most"),
        (GRID, "[vary]", "[set]\nwater.sd_mps = 0.1\n[vary]", r"\[vary\] water.sd_mps: is also in \[set\]"),
        (SOBOL, "high = 0.09", "high = 0.01", r"\[vary\] water.sd_mps.high = 0.01: must be > low"),
        (SOBOL, "low = 1.0", "low = 0.0", r'low = 0.0: must be > 0 where scale = "log"'),
        (CROSSED, HORIZONS, "controller.horizon = [2.5]", r"\[cross\] controller.horizon: unknown key"),
        (CROSSED, HORIZONS, "water.sd_mps = [0.1]", r"\[cross\] water.sd_mps: is also in \[vary\]"),
        (CROSSED, HORIZONS, "controller.horizon_s = []", r"\[cross\] .*must have at least one value"),
        (CROSSED, 'low = 0.5, high = 2.0, scale = "log"', "low = -0.5, high = 2.0", "size = -0.5: a factor must"),
        (CROSSED, "vehicle.dry_mass_kg", "vehicle.dry_mass", r"\[scale.size\] vehicle.dry_mass.*did you mean"),
        (CROSSED, "vehicle.dry_mass_kg", "vehicle.name", r"\[scale.size\] vehicle.name: must be a field with a number"),
        (CROSSED, "[scale.size]", "[scale.mass]", r"\[vary\] size: unknown key"),
        (CROSSED, "[scale.size]", "[scale.mass]\n[scale.size]", r"\[scale.mass\]: .*neither in \[vary\] nor in"),
    ],
)  # fmt: skip
def test_a_file_that_is_wrong_is_refused_by_field(tmp_path: Path, text: str, old: str, new: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem) as refused:
        load(written(tmp_path, text.replace(old, new)))
    assert "c.toml" in str(refused.value)


def test_a_factor_of_what_the_base_has_not_is_refused(tmp_path: Path) -> None:
    text = CROSSED.replace("vehicle.dry_mass_kg", "vehicle.thruster.vertical.max_N")
    path = written(tmp_path, text.replace("[cross]", "[set]\nvehicle = 'surface'\n[cross]"))
    with pytest.raises(ConfigError, match=r"\[vary\] size: .*vehicle.thruster.vertical.max_N: has no base value"):
        plan(load(path), str(path))
