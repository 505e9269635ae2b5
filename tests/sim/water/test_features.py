"""Fronts, steps and internal waves: closed forms by hand, on top of water that stays what it was."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from sim.scenario import Feature, Water
from sim.water import make
from sim.water.column import water_at

S = 1_000_000_000
DEPTHS = np.linspace(-1.0, 90.0, 1831)
FRONT = Feature(kind="front", step_mps=0.2, direction_rad=2.0, at_s=60.0, width_s=30.0)
STEP = Feature(kind="step", step_mps=-0.15, direction_rad=0.5, at_m=23.3)
TIDE = Feature(kind="tide", amplitude_mps=0.3, direction_rad=0.3, period_s=200.0)
WAVES = Feature(kind="waves", amplitude_mps=0.08, direction_rad=-1.0, period_s=400.0)


@pytest.fixture(params=["markov", "changing", "measured"])
def water(request, tmp_path) -> Water:
    if request.param == "measured":
        (tmp_path / "c.csv").write_text("depth_m,v_north_mps,u_east_mps\n4,0.1,-0.2\n23.5,0.0,0.1\n120,-0.1,0.05\n")
        return Water(kind="measured", file=str(tmp_path / "c.csv"))
    return Water(change_mps_per_rts=1e-3 if request.param == "changing" else 0.0)


def added(water: Water, feature: Feature, t_ns: int, depths=DEPTHS) -> np.ndarray:
    """Return the velocity that the feature adds along its direction; across it there is none."""
    plain, with_it = make(water, 3), make(msgspec.structs.replace(water, feature=feature), 3)
    extra = with_it.over(depths, t_ns) - plain.over(depths, t_ns)
    cos, sin = math.cos(feature.direction_rad), math.sin(feature.direction_rad)
    np.testing.assert_allclose(extra @ [-sin, cos], 0.0, atol=1e-14)
    return extra @ [cos, sin]


@pytest.mark.parametrize(
    ("t_s", "share"), [(-30, 0.0), (0, 0.0), (45, 0.0), (52.5, 0.25), (60, 0.5), (71.4, 0.88), (75, 1.0), (500, 1.0)]
)
def test_a_front_changes_the_water_of_all_depths_within_its_width(water, t_s, share):
    np.testing.assert_allclose(added(water, FRONT, round(t_s * S)), 0.2 * share, atol=1e-12)


def test_a_step_is_a_jump_within_a_metre_of_depth_at_all_times(water):
    for t_ns in (-5 * S, 0, 90 * S + 400_000_000):
        expected = -0.15 * np.interp(DEPTHS, [22.8, 23.8], [0.0, 1.0])
        np.testing.assert_allclose(added(water, STEP, t_ns), expected, atol=1e-12)


def test_waves_swing_against_each_other_at_the_surface_and_at_the_deepest(water):
    """sin is sampled every second: a chord of the sine is at most A (2 pi / T)^2 / 8 off, 2.5 um/s."""
    for t_s in (-100.0, 0.0, 33.3, 100.0, 200.0, 750.5):
        time = math.sin(2 * math.pi * t_s / 400.0)
        at_nodes = np.arange(71.0)
        expected = 0.08 * time * np.cos(math.pi * at_nodes / 70.0)
        np.testing.assert_allclose(added(water, WAVES, round(t_s * S), at_nodes), expected, atol=3e-6)
        np.testing.assert_allclose(added(water, WAVES, round(t_s * S), np.array([70.0, 95.0])), -0.08 * time, atol=3e-6)
    half = added(water, WAVES, 100 * S)
    assert half[np.argmin(np.abs(DEPTHS - 35.0))] == pytest.approx(0.0, abs=1e-4)  # the first mode's node


def test_a_tide_is_the_same_at_all_depths(water):
    for t_s in (-20.0, 0.0, 50.0, 130.0):
        expected = 0.3 * math.sin(2 * math.pi * t_s / 200.0)
        np.testing.assert_allclose(added(water, TIDE, round(t_s * S)), expected, atol=1e-12)


@pytest.mark.parametrize("feature", [FRONT, STEP, WAVES, TIDE], ids=lambda f: f.kind)
def test_the_water_with_a_feature_keeps_the_columns_contract(water, feature):
    """Linear in depth between ``depth_m`` and in time between whole seconds, for kernels as for everyone."""
    column = make(msgspec.structs.replace(water, feature=feature), 3)
    assert (np.diff(column.depth_m) > 0).all()
    for second in (-3, 47, 60):
        ends = [column.over(DEPTHS, (second + k) * S) for k in (0, 1)]
        between = column.over(DEPTHS, second * S + 250_000_000)
        np.testing.assert_allclose(between, 0.75 * ends[0] + 0.25 * ends[1], atol=1e-15)
        water = column.sample(second * S + 250_000_000)
        assert water.earlier.shape == water.later.shape == (len(column.depth_m), 2)
        for z in (0.3, 23.4, 69.4):
            assert water_at(z, water)[:2] == column.at(z, second * S + 250_000_000)
            slope = np.subtract(column.at(z + 1e-4, second * S), column.at(z - 1e-4, second * S)) / 2e-4
            start = column.sample(second * S)
            np.testing.assert_allclose(water_at(z, start)[2:], slope, atol=1e-9)


def test_water_without_a_feature_is_untouched_by_its_other_keys():
    assert make(Water(), 3).sample(7 * S).time_weight == 0.0
    plain, other = make(Water(), 3), make(Water(feature=STEP), 3)
    np.testing.assert_array_equal(other.over(DEPTHS[:400], 0), plain.over(DEPTHS[:400], 0))
