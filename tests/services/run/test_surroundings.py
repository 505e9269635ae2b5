"""Fence and bathymetry of a run: in its folder and recording, kept by a replay, and bad ones start nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltv_mpc import Fence
from ltv_mpc.config import to_toml
from ltv_mpc.control.config import ControllerConfig, MotionLimits
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Disc
from ltv_mpc.references.geodesy import Place
from services.bus.options import BusOptions
from services.cli.app import run as command
from services.processes import controller
from services.recording.reader import Recording
from services.replay import replay
from services.replay.nodes import Run
from services.run import folder
from services.run.run_config import Override, resolve
from services.run.settings_files import controller_files, node_settings
from services.supervisor import process_table
from services.tools import lockstep_run
from tests.services.recording.recordings import write

SOUNDINGS = "north_m,east_m,depth_m\n-50,-50,12\n-50,50,12\n50,-50,12\n50,50,12\n"
LIMIT = "controller.limits.min_altitude_m=3"


@pytest.fixture
def bottom(tmp_path: Path) -> Path:
    (tmp_path / "bottom.csv").write_text(SOUNDINGS)
    return tmp_path / "bottom.csv"


@pytest.fixture
def fence(tmp_path: Path) -> Path:
    """Write a fence: the vehicle starts 1 m from its disc, in its margin, and drifts less than 0.5 m in 2 s."""
    hull = resolve("descent").vehicle.hull
    assert hull is not None
    place = Place(north_m=4.0 + hull.radius_m, east_m=0.0)
    fence = Fence(margin_m=2.0, keep_out_disc=(Disc(name="wreck", centre=place, radius_m=3.0),))
    (tmp_path / "f.toml").write_text(to_toml(fence))
    return tmp_path / "f.toml"


def test_both_of_a_scenario_are_saved_used_and_kept_by_a_replay(tmp_path: Path, fence: Path, bottom: Path) -> None:
    settings = [f"fence={fence}", f"bathymetry={bottom}", LIMIT, "run.duration_s=2", "run.perfect_state=true"]
    run_config = resolve("descent", [Override("test", settings)])
    run = folder.make("descent", run_config.files, out=tmp_path / "run")
    summary = lockstep_run.run(run_config, run)
    (zone,) = summary.fence
    assert zone.zone == 'keep_out_disc[0] "wreck"'
    assert zone.least_clearance_m == pytest.approx(1.0, abs=0.5)  # of the true hull
    assert 0 < summary.fence_exceeded <= summary.cycles
    assert (zone.in_margin_s, zone.inside_s) == (pytest.approx(2.0, abs=0.02), 0.0)

    kept = Fence.load(str(fence))
    fence.unlink()
    bottom.unlink()
    again = resolve(str(run.scenario))
    assert again.fence == Fence.load(str(run.path / "config" / "fence.toml")) == kept
    assert again.bathymetry is not None
    recorded = {message.key: message.plain for message in Recording(run.recording)}
    assert [zone["label"] for zone in recorded["fence"]["zones"]] == ['keep_out_disc[0] "wreck"']
    assert recorded["plan"]["depth_limit_m"] == pytest.approx(9.0)
    verdict = replay.replay(replay.Run(run.recording))
    assert verdict.identical
    assert verdict.steps_compared > 10
    process = process_table.config_of("controller", run_config, run, BusOptions(connect=("tcp/127.0.0.1:1",)))
    assert isinstance(process, controller.Config)
    assert process.bathymetry is not None
    assert Path(process.bathymetry).read_text() == SOUNDINGS


def test_a_scenario_file_names_a_bathymetry_in_its_own_folder(tmp_path: Path, bottom: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        f'title = "mine"\nbathymetry = "{bottom.name}"\n[controller.limits]\nmin_altitude_m = 3.0\n'
    )
    assert resolve(str(tmp_path / "mine.toml")).bathymetry is not None


def test_the_settings_that_a_controller_publishes_have_its_bathymetry(bottom: Path, tmp_path: Path) -> None:
    settings = ControllerConfig(limits=MotionLimits(min_altitude_m=3.0))
    published = node_settings("controller", controller_files("paper", "square", "", str(bottom), settings))
    assert published is not None
    node = Run(write(tmp_path / "run.mcap", [("controller", published, 1, 0, 0)])).make("controller", 1)
    assert isinstance(node, ControllerNode)
    assert node.controller.bathymetry is not None


def test_what_cannot_be_used_is_rejected_before_anything_starts(tmp_path, fence, bottom, capsys) -> None:
    head, hull = resolve("descent").files["config/vehicle.toml"].split("[hull]")
    (tmp_path / "bare.toml").write_text(head + "[" + hull.split("\n[", 1)[1])
    needs_limit = r"\[limits\] min_altitude_m: is missing: a bathymetry needs it"
    for settings, says in (
        (["bathymetry=nowhere.csv", LIMIT], r"bathymetry nowhere\.csv: no such file"),
        ([f"bathymetry={bottom}"], needs_limit),
        ([f"fence={fence}", f"vehicle={tmp_path / 'bare.toml'}"], r"\[hull\]: is missing"),
    ):
        with pytest.raises(ConfigError, match=says):
            resolve("descent", [Override("test", settings)])
    assert command(["controller", "--bathymetry", str(bottom)]) == 2
    assert "min_altitude_m: is missing: a bathymetry needs it" in capsys.readouterr().err
