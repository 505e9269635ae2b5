"""Files in a run's folder: the inputs as read, complete enough to repeat the run."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from ltv_mpc.localisation import sensor_config
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.vehicle import parameters
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.reference_point import ORIGIN
from services.run.run_config import Override, resolve

UPON = """
base = "realistic"  # with a better gauge
name = "mine"
[pressure]
depth_sd_m = 0.001
[usbl]
period_ns = 1_000_000_000
latency_ns = 500_000_000
ship_m = [0.1, -3.0]
position_sd_m = 0.3
bearing_sd_rad = 0.01
missing_share = 0.0
outlier_share = 0.0
outlier_m = 0.0
"""


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(UPON)
    return path


def test_sensors_upon_a_base_are_kept_resolved_so_that_the_base_may_change(mine: Path, tmp_path: Path) -> None:
    here = resolve("descent", [Override("test", [f"sensors={mine}"])])
    kept = tmp_path / "kept.toml"
    kept.write_text(here.files["config/sensors.toml"])
    assert "base" not in tomllib.loads(kept.read_text())
    assert SensorConfig.load(str(kept)) == here.sensor_config == SensorConfig.load(str(mine))
    assert here.sensor_config.pressure.depth_sd_m == 0.001
    assert here.sensor_config.imu == SensorConfig.load("realistic").imu


def test_sensors_that_stand_alone_are_kept_as_they_were_written(tmp_path: Path) -> None:
    text = (Path(sensor_config.__file__).parent / "files" / "paper.toml").read_text()
    alone = tmp_path / "alone.toml"
    alone.write_text(text + "\n# mine now\n")
    for name, expected in (("paper", text), (str(alone), text + "\n# mine now\n")):
        here = resolve("descent", [Override("test", [f"sensors={name}"])])
        assert here.files["config/sensors.toml"] == expected


@pytest.mark.usefixtures("mine")
def test_a_scenario_names_sensors_and_prior_from_its_own_folder(tmp_path, monkeypatch) -> None:
    (tmp_path / "known.csv").write_text("depth_m,v_north_mps,u_east_mps,sd_mps,sd_common_mps\n0,0,0,1,0\n")
    (tmp_path / "s.toml").write_text('title = "x"\nsensors = "mine.toml"\n[estimator]\nwater_prior = "known.csv"\n')
    monkeypatch.chdir("/")
    here = resolve(str(tmp_path / "s.toml"))
    assert here.sensor_config.name == "mine"
    assert here.prior is not None
    assert here.prior.sd_mps.tolist() == [1.0]
    assert any("water prior known.csv: 0 to 0 m, sd 1000.0 to 1000.0 mm/s" in note for note in here.notes)
    assert resolve("descent").prior is None


def test_a_run_has_no_reference_point_because_its_estimates_are_of_the_origin(tmp_path: Path) -> None:
    """Its own vehicle file says so too, so that replay and a run made again agree."""
    template = (Path(parameters.__file__).parent / "template.toml").read_text()
    (tmp_path / "mine.toml").write_text(template.replace("forward_m = 0.0", "forward_m = 0.5"))
    here = resolve("descent", [Override("test", [f"vehicle={tmp_path / 'mine.toml'}"])])
    (tmp_path / "kept.toml").write_text(here.files["config/vehicle.toml"])
    assert here.vehicle == Vehicle.load(str(tmp_path / "kept.toml"))
    assert here.vehicle.reference_point == ORIGIN
    assert here.vehicle.name == "mine"
    assert any("[reference_point]" in note for note in here.notes)
    assert not any("[reference_point]" in note for note in resolve("descent").notes)
