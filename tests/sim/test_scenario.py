"""Scenarios: what --set does, what no single field can tell, and that what is written is read back."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from sim.scenario import Scenario, checked, with_overrides


@pytest.mark.parametrize("name", ["descent", "hover", "paper-no-control", "paper-2.5s", "paper-5s"])
def test_a_scenario_written_as_toml_is_read_back_bit_for_bit(name: str) -> None:
    scenario = Scenario.load(name)
    assert config.parse(tomllib.loads(config.to_toml(scenario)), Scenario, source="x") == scenario


def test_an_assignment_changes_its_key_and_nothing_else() -> None:
    before = Scenario.load("descent")
    after = with_overrides(
        before, ["water.sd_mps=0.1", "run.perfect_state=true", "run.seed=1", "run.seed = 7", "vehicle=my otter.toml"]
    )
    assert (after.water.sd_mps, after.run.perfect_state, after.run.seed) == (0.1, True, 7)
    assert after.vehicle == "my otter.toml"
    back = [f"water.sd_mps={before.water.sd_mps}", "run.perfect_state=false", "run.seed=0", 'vehicle="paper"']
    assert with_overrides(after, back) == before


def test_the_order_of_assignments_does_not_matter() -> None:
    both = ["controller.ages.degraded_s=12", "controller.ages.hold_s=15"]  # 12 alone contradicts the default of hold_s
    for assignments in (both, both[::-1]):
        assert with_overrides(Scenario.load("descent"), assignments).controller.ages.hold_s == 15.0
    with pytest.raises(ConfigError, match=r"ages: hold_s = 10: must be >= degraded_s = 12"):
        with_overrides(Scenario.load("descent"), both[:1])


def test_the_paper_s_cases_have_its_delays_and_its_cost() -> None:
    none, short, long = (Scenario.load(f"paper-{name}") for name in ("no-control", "2.5s", "5s"))
    assert not none.controller.lateral
    assert [(one.controller.horizon_s, one.run.compute_delay_s) for one in (short, long)] == [(2.5, 0.40), (5.0, 0.71)]
    for one in (short, long):
        weights = one.controller.weights
        assert weights.terminal_position_per_m2 == weights.terminal_velocity_s2_per_m2 == 0.0


def test_a_bed_and_a_feature_are_set_by_their_keys_and_read_back(tmp_path: Path) -> None:
    wanted = ["water.bottom_m=35", "water.feature.kind=front", "water.feature.step_mps=-0.2"]
    scenario = checked(with_overrides(Scenario.load("descent"), wanted), source="x")
    assert (scenario.water.bottom_m, scenario.water.feature.kind) == (35.0, "front")
    assert scenario.water.feature.step_mps == -0.2
    (tmp_path / "again.toml").write_text(config.to_toml(scenario))
    assert Scenario.load(str(tmp_path / "again.toml")) == scenario
    assert Scenario.load("descent").water.bottom_m is None


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ("controller.weights.thrst=1", 'unknown key; did you mean "controller.weights.thrust"?'),
        ("controller.weights=1", "is a table: set one of controller.weights.position_per_m2, "),
        ("run.seed=1\nrun.speed=3", "must be an integer"),
        ("=", 'option --set: "": unknown key'),
    ],
)
def test_an_assignment_that_fits_no_key_says_what_would(assignment: str, says: str) -> None:
    with pytest.raises(ConfigError) as error:
        with_overrides(Scenario.load("descent"), [assignment])
    assert says in str(error.value)
    assert str(error.value).isprintable()


@pytest.mark.parametrize(
    ("assignments", "says"),
    [
        (["water.kind=measured"], '[water] file = "": must name a currents CSV'),
        (["water.file=a.csv"], 'is not read where kind = "markov"'),
        (["water.cell_m=100"], "[water] cell_m = 100.0: must be <= deepest_m = 70"),
        (["estimator.deepest_m=2000"], "[estimator] cell_m = 1.0: must be <= deepest_m = 2000, and at least 4: at"),
        (["water.bottom_m=12", "plant.depth_m=12"], "[water] bottom_m = 12.0: must be deeper than the start of the"),
        (["water.feature.step_mps=0.2"], '[water.feature] kind = "none": must be "front", "step", "waves" or "tide"'),
        (["water.surface_waves.height_m=1", "water.surface_waves.period_s=2"], "[water.surface_waves] height_m ="),
        (["plant.depth_m=20", "plant.wind.gust_N=1"], "[plant] depth_m = 20.0: must be less than 0.5 where"),
    ],
)
def test_fields_that_contradict_each_other_are_refused(assignments: list[str], says: str) -> None:
    with pytest.raises(ConfigError) as error:
        checked(with_overrides(Scenario.load("descent"), assignments), source="scenario descent")
    assert says in str(error.value)


def test_files_that_a_scenario_names_are_beside_it_and_shipped_names_stay(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        'title = "x"\nvehicle = "cars/otter.toml"\nsensors = "realistic"\nreference = "/abs/line.toml"\n'
        '[water]\nkind = "measured"\nfile = "a.csv"\n'
    )
    scenario = Scenario.load(str(file))
    assert scenario.vehicle == str(tmp_path / "cars/otter.toml")
    assert scenario.sensors == "realistic"
    assert scenario.reference == "/abs/line.toml"
    assert scenario.water.file == str(tmp_path / "a.csv")


def test_the_run_begins_afloat_and_ends_after_the_descent() -> None:
    scenario = with_overrides(Scenario.load("descent"), ["run.surface_time_s=2.5", "run.duration_s=10"])
    assert (scenario.start_ns, scenario.end_ns) == (-2_500_000_000, 10_000_000_000)
