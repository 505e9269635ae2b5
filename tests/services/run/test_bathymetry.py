"""Bathymetry of a run: it is in the folder, the controller of each kind of run has it, and a bad one starts nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltv_mpc.control.config import ControllerConfig, MotionLimits
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.errors import ConfigError
from services.bus.options import BusOptions
from services.cli.app import run as command
from services.processes import controller
from services.recording.reader import Recording
from services.replay import replay
from services.replay.nodes import RecordedNodes
from services.run import folder
from services.run.run_config import Override, resolve
from services.run.settings_files import controller_files, node_settings
from services.supervisor import process_table
from services.tools import lockstep_run

SOUNDINGS = "north_m,east_m,depth_m\n-50,-50,12\n-50,50,12\n50,-50,12\n50,50,12\n"
LIMIT = "controller.limits.min_altitude_m=3"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "bottom.csv").write_text(SOUNDINGS)
    return tmp_path / "bottom.csv"


def test_the_bathymetry_of_a_scenario_is_saved_used_and_kept_by_a_replay(tmp_path: Path, file: Path) -> None:
    settings = [f"bathymetry={file}", LIMIT, "run.duration_s=2", "run.perfect_state=true"]
    run_config = resolve("descent", [Override("test", settings)])
    run = folder.make("descent", run_config.files, out=tmp_path / "run")
    lockstep_run.run(run_config, run)
    file.unlink()
    assert resolve(str(run.scenario)).bathymetry is not None
    limits = [message.plain["depth_limit_m"] for message in Recording(run.recording) if message.key == "plan"]
    assert limits[-1] == pytest.approx(9.0)
    verdict = replay.replay(replay.Run(run.recording))
    assert verdict.identical
    assert verdict.steps_compared > 10
    process = process_table.config_of("controller", run_config, run, BusOptions(connect=("tcp/127.0.0.1:1",)))
    assert isinstance(process, controller.Config)
    assert Path(process.bathymetry).read_text() == SOUNDINGS


def test_a_scenario_file_names_a_bathymetry_in_its_own_folder(tmp_path: Path, file: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        f'title = "mine"\nbathymetry = "{file.name}"\n[controller.limits]\nmin_altitude_m = 3.0\n'
    )
    assert resolve(str(tmp_path / "mine.toml")).bathymetry is not None


def test_the_settings_that_a_controller_publishes_have_its_bathymetry(file: Path) -> None:
    settings = ControllerConfig(limits=MotionLimits(min_altitude_m=3.0))
    published = node_settings("controller", controller_files("paper", "square", "", str(file), settings))
    assert published is not None
    assert published.files["config/bathymetry.csv"] == SOUNDINGS
    nodes = RecordedNodes("test", {"controller": {1: published}}, (0, 0))
    node = nodes.make("controller", 1)
    assert isinstance(node, ControllerNode)
    assert node.controller.bathymetry is not None


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (["bathymetry=nowhere.csv", LIMIT], r"bathymetry nowhere\.csv: no such file"),
        (["bathymetry=FILE"], r"\[limits\] min_altitude_m: is missing: a bathymetry needs it"),
    ],
)
def test_a_bathymetry_that_cannot_be_used_is_rejected_before_anything_starts(
    file: Path, settings: list[str], says: str
) -> None:
    with pytest.raises(ConfigError, match=says):
        resolve("descent", [Override("test", [text.replace("FILE", str(file)) for text in settings])])


def test_the_controller_alone_takes_a_bathymetry(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(["controller", "--bathymetry", str(file)]) == 2
    assert "min_altitude_m: is missing: a bathymetry needs it" in capsys.readouterr().err
