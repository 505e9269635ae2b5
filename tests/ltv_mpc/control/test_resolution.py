"""One rule for every controller: the horizon and the weights that its settings leave out follow from the vehicle."""

from __future__ import annotations

import math

import msgspec
import pytest

from ltv_mpc import Controller, ControllerConfig, Vehicle, config, references
from ltv_mpc.control.config import MotionLimits, WeightSettings
from ltv_mpc.control.resolution import settled
from ltv_mpc.errors import ConfigError
from services.run.run_config import Override, resolve
from services.tools.vehicle_check import check


def test_controller_and_simulation_use_the_horizon_that_the_check_proposes() -> None:
    vehicle = Vehicle.load("surface")
    proposed_s = check(vehicle).horizon_s
    assert settled(ControllerConfig(), vehicle).horizon_s == proposed_s
    assert Controller(vehicle, references.Point(north_m=0.0, east_m=0.0)).config.horizon_s == proposed_s
    run_config = resolve("descent", [Override("test", ["vehicle=surface"])])
    assert run_config.controller.horizon_s == proposed_s
    assert f"horizon {proposed_s:g} s" in run_config.notes[0]


@pytest.mark.parametrize("name", ["paper", "surface"])
def test_the_effort_scales_both_weights_on_thrust_alike_for_every_vehicle(name: str) -> None:
    low, normal, high = (
        settled(ControllerConfig(effort=effort), Vehicle.load(name)).weights for effort in ("low", "normal", "high")
    )
    assert low.thrust > normal.thrust > high.thrust
    for more, less in ((low, normal), (normal, high)):
        assert more.thrust / less.thrust == pytest.approx(more.thrust_change / less.thrust_change, rel=0.01)
        assert more.position_per_m2 == less.position_per_m2


def test_a_given_weight_comes_before_the_effort_and_an_unknown_effort_is_rejected(tmp_path) -> None:
    given = ControllerConfig(effort="low", weights=WeightSettings(thrust=0.7))
    assert settled(given, Vehicle.load("paper")).weights.thrust == 0.7
    (tmp_path / "mine.toml").write_text('effort = "lowest"\n')
    with pytest.raises(ConfigError, match=r"mine.toml: effort = .lowest.: must be"):
        ControllerConfig.load(str(tmp_path / "mine.toml"))


def test_resolved_settings_and_those_read_back_from_their_file_are_the_same(tmp_path) -> None:
    vehicle = Vehicle.load("surface")
    found = settled(ControllerConfig(), vehicle)
    assert settled(found, Vehicle.load("paper")) is found
    (tmp_path / "controller.toml").write_text(config.to_toml(found))
    assert settled(ControllerConfig.load(str(tmp_path / "controller.toml")), Vehicle.load("paper")) == found


def test_a_period_longer_than_the_horizon_is_rejected_with_file_and_field() -> None:
    vehicle, long = Vehicle.load("paper"), ControllerConfig(period_s=20.0)
    with pytest.raises(
        ConfigError, match=r"mine\.toml: \[controller\] period_s = 20\.0: must be <= horizon_s = 13\.8,"
    ):
        settled(long, vehicle, source="mine.toml", table=("controller",))
    with pytest.raises(ConfigError, match=r"period_s = 20\.0: must be <= horizon_s = 5: a plan"):
        settled(msgspec.structs.replace(long, horizon_s=5.0), vehicle)
    assert settled(msgspec.structs.replace(long, horizon_s=30.0), vehicle).period_s == 20.0


@pytest.mark.parametrize("width_m", [-1.0, math.nan, math.inf])
def test_settings_made_in_python_have_the_bounds_of_the_file(width_m: float) -> None:
    wrong = ControllerConfig(limits=MotionLimits(max_cross_track_m=width_m))
    with pytest.raises(ConfigError, match=rf"controller settings: \[limits\] max_cross_track_m = {width_m}: must be"):
        settled(wrong, Vehicle.load("paper"))


def test_a_run_writes_the_horizon_that_it_had_and_is_repeated_with_it(tmp_path) -> None:
    files = resolve("descent").files
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert "horizon_s = 13.8" in files["scenario.toml"]
    assert "horizon_s = 13.8" in files["config/controller.toml"]
    assert resolve(str(tmp_path / "scenario.toml")).controller == resolve("descent").controller
