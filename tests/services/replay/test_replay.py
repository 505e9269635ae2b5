"""Replay of a run, byte for byte: differences are found and named, losses are gaps."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from ltv_mpc.errors import ConfigError
from services.bus import wire
from services.recording.reader import StoredMessage
from services.replay import replay as engine
from services.replay.comparison import NOT_RECORDED, NOT_REPLAYED
from services.replay.verdict import NodeVerdict, Verdict
from services.run.provenance import provenance_table
from tests.services.recording.recordings import write
from tests.services.replay.altered import Plain, messages, rewritten, without
from tests.services.words import status


def replayed(recording: Path, **options: Any) -> Verdict:
    return engine.replay(engine.Run(recording), **options)


def of(verdict: Verdict, name: str) -> NodeVerdict:
    (node,) = (node for node in verdict.nodes if node.node == name)
    return node


def test_every_step_of_a_run_in_lock_step_is_identical_from_the_file_alone(recording: Path, tmp_path: Path) -> None:
    """The file alone is enough: it has the settings. The last plan was still on its way when the run ended."""
    bare = Path(shutil.copy(recording, tmp_path / "elsewhere.mcap"))
    verdict = replayed(bare)
    assert verdict.identical
    assert verdict.steps_run == verdict.steps_compared == verdict.steps_identical
    assert [(node.node, node.starts, node.outputs_lost) for node in verdict.nodes] == [
        (name, 1, 0) for name in ("plant", "sensors", "estimator", "controller")
    ]
    assert (of(verdict, "plant").steps_run, of(verdict, "sensors").steps_run) == (81, 401)
    assert of(verdict, "controller").outputs_compared >= of(verdict, "controller").steps_run >= 8
    assert (verdict.cut, verdict.provenance_differences, verdict.first_difference) == (False, (), None)
    assert verdict.vehicle_s == 4.0


@pytest.mark.parametrize("keep_crc", [False, True])
def test_one_digit_of_a_plan_is_found_and_named(recording: Path, tmp_path: Path, keep_crc: bool) -> None:
    """The CRC reveals another frame, the bytes of the file an edited file."""

    def damaged(stored: StoredMessage, plain: Plain) -> Iterable[Plain]:
        if stored.key == "plan" and plain["sequence"] == 4:
            row = plain["thrust_N"][3]
            thrusts_N.append(row[1])
            row[1] += 1e-9
            thrusts_N.append(row[1])
        return [plain]

    thrusts_N: list[float] = []
    verdict = replayed(rewritten(recording, tmp_path / "run.mcap", damaged, keep_crc=keep_crc))
    assert not verdict.identical
    difference = verdict.first_difference
    assert difference is not None
    assert (difference.node, difference.key, difference.sequence) == ("controller", "plan", 4)
    assert [(field.path, field.replayed, field.recorded) for field in difference.fields] == [
        ("thrust_N[3][1]", *thrusts_N)
    ]
    controller, plant = of(verdict, "controller"), of(verdict, "plant")
    assert controller.steps_run == controller.steps_compared == controller.steps_identical + 1
    if not keep_crc:  # the plant was given a frame that is not there
        assert plant.steps_compared == plant.steps_identical < plant.steps_run
        assert "plan 4 (" in plant.gaps[0].why


def test_the_same_values_in_another_spelling_are_another_frame(recording: Path, tmp_path: Path) -> None:
    """JSON is the same: only the checksum of the frame differs."""

    def backwards(message: Plain) -> bytes:
        return wire.pack(dict(reversed(message.items())) if "solve" in message else message)

    out = rewritten(recording, tmp_path / "run.mcap", lambda _, plain: [plain], spell=backwards)
    difference = replayed(out, only="controller").first_difference
    assert difference is not None
    assert (difference.key, difference.sequence, difference.fields) == ("plan", 0, ())
    assert "another encoding" in difference.what


@pytest.mark.parametrize(
    ("key", "sequence", "node"),
    [("sensor/imu", 70, "estimator"), ("record/estimator", 120, "estimator"), ("world/truth", 120, "sensors")],
)
def test_a_lost_message_is_a_gap_and_all_before_it_is_compared(recording, tmp_path, key, sequence, node) -> None:
    verdict = replayed(rewritten(recording, tmp_path / "run.mcap", without(key, sequence)))
    assert verdict.identical  # of what can be compared
    (gap,) = of(verdict, node).gaps
    assert gap.first_step + gap.steps == of(verdict, node).steps_run
    assert gap.first_step == of(verdict, node).steps_compared > 100
    assert "is not in the file" in gap.why
    assert ("the record of step 120" if key == "record/estimator" else f"{key} {sequence} (") in gap.why
    others = [other for other in verdict.nodes if other.node != node]
    assert all(other.steps_compared >= other.steps_run - 1 and not other.gaps for other in others)


def test_a_lost_output_is_counted_and_its_step_is_not_compared(recording: Path, tmp_path: Path) -> None:
    verdict = replayed(rewritten(recording, tmp_path / "run.mcap", without("localisation", 1)), only="estimator")
    assert verdict.identical
    estimator = of(verdict, "estimator")
    assert (estimator.outputs_lost, estimator.steps_compared) == (1, estimator.steps_run - 1)
    assert not estimator.gaps


@pytest.mark.parametrize("damaged_first", [True, False])
def test_a_damaged_copy_beside_the_right_frame_changes_nothing(recording, tmp_path, damaged_first) -> None:
    """As a recorder on both sides of a bad link receives it, for inputs and outputs."""

    def doubled(stored: StoredMessage, plain: Plain) -> Iterable[Plain]:
        if stored.key == "sensor/depth":
            copy = plain | {"depth_m": plain["depth_m"] + 1.0}
        elif stored.key == "plan":
            copy = plain | {"thrust_N": [[0.0, 0.0, 0.0]] * len(plain["thrust_N"])}
        else:
            return [plain]
        return [copy, plain] if damaged_first else [plain, plain, copy]

    verdict = replayed(rewritten(recording, tmp_path / "run.mcap", doubled))
    assert verdict.identical
    assert verdict.steps_compared == verdict.steps_run


def test_an_input_may_stand_in_the_file_behind_the_record_that_names_it(recording: Path, tmp_path: Path) -> None:
    held: list[Plain] = []

    def late(stored: StoredMessage, plain: Plain) -> Iterable[Plain]:
        """Return a change that delays each sensor message by five."""
        if stored.key != "sensor/imu":
            return [plain]
        held.append(plain)
        if plain["sequence"] == last:
            return held
        return [held.pop(0)] if len(held) > 5 else []

    last = max(plain["sequence"] for stored, plain in messages(recording) if stored.key == "sensor/imu")
    verdict = replayed(rewritten(recording, tmp_path / "run.mcap", late), only="estimator")
    assert verdict.identical
    assert verdict.steps_compared == verdict.steps_run


def test_outputs_that_nothing_lost_explains_are_differences(recording: Path, tmp_path: Path) -> None:
    def silent(stored: StoredMessage, plain: Plain) -> Iterable[Plain]:
        return [] if stored.key == "localisation" else [plain]

    def talkative(stored: StoredMessage, plain: Plain) -> Iterable[Plain]:
        again = stored.key == "localisation" and plain["sequence"] == last
        return [plain, plain | {"sequence": last + 1}] if again else [plain]

    last = max(plain["sequence"] for stored, plain in messages(recording) if stored.key == "localisation")
    for change, what in ((silent, NOT_RECORDED), (talkative, NOT_REPLAYED)):
        verdict = replayed(rewritten(recording, tmp_path / "run.mcap", change), only="estimator")
        assert not verdict.identical
        assert verdict.first_difference is not None
        assert (verdict.first_difference.key, verdict.first_difference.what) == ("localisation", what)


def test_steps_known_only_from_the_process_report_are_run_and_not_compared(recording: Path, tmp_path: Path) -> None:
    steps = sum(stored.key == "record/controller" for stored, _ in messages(recording))
    word = status("controller", t_ns=3_000_000_000, steps=steps + 100)
    write(tmp_path / "run.2.mcap", [("controller", word, 1, 0, 3_000_000_000)])
    out = Path(shutil.copy(recording, tmp_path / "run.mcap"))
    controller = of(replayed(out, only="controller"), "controller")
    assert (controller.steps_compared, controller.steps_run) == (steps, steps + 100)
    assert [(gap.first_step, gap.steps) for gap in controller.gaps] == [(steps, 100)]


def test_provenance_differences_of_another_machine_are_reported(recording: Path, tmp_path: Path) -> None:
    metadata = dict(engine.Run(recording).metadata)
    metadata["scenario.toml"] = metadata["scenario.toml"].replace(provenance_table()["processor"], "Motorola 6502")
    out = rewritten(recording, tmp_path / "run.mcap", lambda _, plain: [plain], metadata=metadata)
    verdict = replayed(out, only="controller")
    assert verdict.identical
    assert [node.node for node in verdict.nodes] == ["controller"]
    assert [(entry.what, entry.run, entry.here) for entry in verdict.provenance_differences] == [
        ("processor", "Motorola 6502", provenance_table()["processor"])
    ]


def test_a_recording_without_settings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"run\.mcap: has no settings to build a node from"):
        engine.Run(write(tmp_path / "run.mcap", []))
