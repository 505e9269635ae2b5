"""Fence of a run: it is in the folder and the recording, a replay keeps it, and a bad one starts nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltv_mpc import Fence
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Disc
from ltv_mpc.references.geodesy import Place
from services.recording.reader import Recording
from services.replay import replay
from services.run import folder
from services.run.run_config import Override, resolve
from services.tools import lockstep_run

FENCE = Fence(margin_m=2.0, keep_out_disc=(Disc(name="wreck", centre=Place(north_m=50.0, east_m=0.0), radius_m=3.0),))


def test_the_fence_of_a_scenario_is_published_saved_and_kept_by_a_replay(tmp_path: Path) -> None:
    file = tmp_path / "fence.toml"
    FENCE.save(str(file))
    settings = [f"fence={file}", "run.duration_s=2", "run.perfect_state=true"]
    run_config = resolve("descent", [Override("test", settings)])
    run = folder.make("descent", run_config.files, out=tmp_path / "run")
    assert lockstep_run.run(run_config, run).fence_exceeded == 0
    file.unlink()
    assert Fence.load(str(run.path / "config" / "fence.toml")) == FENCE
    assert resolve(str(run.scenario)).fence == FENCE
    zones = [message.plain["zones"] for message in Recording(run.recording) if message.key == "fence"]
    assert [zone["label"] for zone in zones[0]] == ['keep_out_disc[0] "wreck"']
    verdict = replay.replay(replay.Run(run.recording))
    assert verdict.identical
    assert verdict.steps_compared > 10


def test_a_fence_for_a_vehicle_without_hull_is_rejected_before_anything_starts(tmp_path: Path) -> None:
    file, vehicle = tmp_path / "fence.toml", tmp_path / "bare.toml"
    FENCE.save(str(file))
    text = resolve("descent").files["config/vehicle.toml"]
    head, hull = text.split("[hull]")
    vehicle.write_text(head + "[" + hull.split("\n[", 1)[1])
    with pytest.raises(ConfigError, match=r"\[hull\]: is missing"):
        resolve("descent", [Override("test", [f"fence={file}", f"vehicle={vehicle}"])])


def test_the_summary_has_the_distance_of_the_true_hull_from_each_zone(tmp_path: Path) -> None:
    """The vehicle starts 1 m from the disc, in its margin, and drifts less than 0.5 m in 2 s."""
    vehicle = resolve("descent").vehicle
    assert vehicle.hull is not None
    file, north_m = tmp_path / "fence.toml", 4.0 + vehicle.hull.radius_m
    place = Place(north_m=north_m, east_m=0.0)
    Fence(margin_m=2.0, keep_out_disc=(Disc(centre=place, radius_m=3.0),)).save(str(file))
    settings = [f"fence={file}", "run.duration_s=2", "run.perfect_state=true"]
    run_config = resolve("descent", [Override("test", settings)])
    run = folder.make("descent", run_config.files, out=tmp_path / "run")
    summary = lockstep_run.run(run_config, run)
    (zone,) = summary.fence
    assert zone.zone == "keep_out_disc[0]"
    assert zone.least_clearance_m == pytest.approx(1.0, abs=0.5)
    assert 0 < summary.fence_exceeded <= summary.cycles
    assert (zone.in_margin_s, zone.inside_s) == (pytest.approx(2.0, abs=0.02), 0.0)
