"""Recordings beside a vehicle: nodes are built from the settings that their processes published, start by start."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.messages import NodeSettings
from services.bus import wire
from services.recording.writer import VEHICLE_MODE, RunWriter
from services.replay import replay as engine
from services.run.folder import RunFolder
from services.run.settings_files import controller_files, estimator_files, node_settings
from tests.services.replay.altered import messages

ABOARD = ("estimator", "controller")


@pytest.fixture(scope="module")
def settings(locked_run: RunFolder) -> dict[str, NodeSettings]:
    """Return what the two processes aboard would have published."""
    of = locked_run.config
    controller = controller_files(
        str(of("vehicle")), str(of("reference")), "", "", ControllerConfig.load(str(of("controller")))
    )
    estimator = estimator_files(str(of("sensors")), EstimatorConfig.load(str(of("estimator"))))
    made = node_settings("controller", controller), node_settings("estimator", estimator)
    return {one.node: one for one in made if one is not None}


def recorded(
    recording: Path, out: Path, settings: Mapping[str, NodeSettings], *, first_step: int = 0, epochs: bool = True
) -> Path:
    """Write the run as a recorder beside its vehicle has it: without the simulation's settings and true states.

    The recorder starts at step ``first_step`` of the controller. Without ``epochs`` the settings are of other starts.
    """
    stored = messages(recording)
    begins = next(
        i for i, (one, plain) in enumerate(stored) if one.key == "record/controller" and plain["step"] == first_step
    )
    stored = stored[begins if first_step else 0 :]
    with RunWriter(out, start_ns=0, metadata={"mode": VEHICLE_MODE}, flush_s=None) as writer:
        for one, plain in stored:
            node = one.key.removeprefix("record/")
            if node in settings and plain["step"] % 20 == first_step % 20:  # repeated, as every ten seconds
                header = wire.Header(epoch=plain["epoch"] + (not epochs), sequence=plain["step"])
                writer.write(node, settings[node], header, one.t_ns)
            if one.kind is not None and not one.key.startswith("world/"):
                writer.write_plain(one.key, one.kind, plain, one.t_ns, one.crc)
    return out


def test_controller_and_estimator_replay_to_the_byte_from_their_own_settings(recording, settings, tmp_path) -> None:
    run = engine.Run(recorded(recording, tmp_path / "run.mcap", settings))
    verdict = engine.replay(run)
    assert (verdict.scenario, verdict.mode, run.names) == ("paper", "vehicle", ABOARD)
    assert verdict.identical
    assert [(node.node, node.steps_run == node.steps_identical > 8) for node in verdict.nodes] == [
        (name, True) for name in ABOARD
    ]
    assert not verdict.provenance_differences


def test_other_settings_can_be_tried_on_a_vehicle_s_recording(recording, settings, locked_run, tmp_path) -> None:
    run = engine.Run(recorded(recording, tmp_path / "run.mcap", settings))
    same = engine.what_if(run, locked_run.config("controller"))
    assert (same.changes, same.deviations[0].max_abs) == ((), 0.0)
    (tmp_path / "mine.toml").write_text("horizon_s = 5.0\n[weights]\nthrust = 0.3\n")
    other = engine.what_if(run, tmp_path / "mine.toml")
    assert "weights.thrust" in [change.key for change in other.changes]
    assert other.deviations[0].rms > 1.0


def test_steps_before_a_late_recorder_cannot_be_repeated_and_the_verdict_tells_it(
    recording: Path, settings: dict[str, NodeSettings], tmp_path: Path
) -> None:
    run = engine.Run(recorded(recording, tmp_path / "run.mcap", settings, first_step=4))
    verdict = engine.replay(run, only="controller")
    assert not verdict.identical
    (gap,) = verdict.nodes[0].gaps
    assert "before the recorder was there" in gap.why


def test_a_start_whose_settings_are_missing_is_not_replayed_with_those_of_another(
    recording: Path, settings: dict[str, NodeSettings], tmp_path: Path
) -> None:
    run = engine.Run(recorded(recording, tmp_path / "run.mcap", settings, epochs=False))
    verdict = engine.replay(run, only="controller")
    assert [gap.why for gap in verdict.nodes[0].gaps] == ["the settings of this controller are not in the file"]


def test_settings_that_this_version_rejects_name_the_recording_and_the_field(recording, settings, tmp_path) -> None:
    wrong = settings["controller"].files | {"config/controller.toml": "horizon_s = -1.0\n"}
    changed = settings | {"controller": NodeSettings(node="controller", files=wrong, made_by={})}
    path = recorded(recording, tmp_path / "run.mcap", changed)
    with pytest.raises(ConfigError, match=r"run\.mcap: .*horizon_s = -1\.0.*config/controller\.toml.*must be"):
        engine.replay(engine.Run(path), only="controller")
