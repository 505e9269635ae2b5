"""Epochs: frames kept while a file is read, and a node that raises where the recorded one did not."""

from __future__ import annotations

import msgspec

from ltv_mpc.messages import InboxEntry, Message, PressureDepth, RecordedStep, StepRecord
from ltv_mpc.node import Grid, Inbox
from services.bus import wire
from services.bus.wire import Header
from services.recording.reader import StoredMessage
from services.replay.comparison import Comparison
from services.replay.epoch import REACH, Epoch, Frames


def depth(sequence: int) -> tuple[StoredMessage, Header]:
    signal, header = PressureDepth(t_ns=sequence, depth_m=1.0), Header(epoch=7, sequence=sequence)
    plain = wire.to_map(signal, header)
    stored = StoredMessage(
        "sensor/depth", PressureDepth, sequence, wire.crc(wire.pack(plain)), msgspec.json.encode(plain)
    )
    return stored, header


def entry(stored: StoredMessage, header: Header) -> InboxEntry:
    return InboxEntry(
        key=stored.key, epoch=header.epoch, sequence=header.sequence, crc=stored.crc, received_t_ns=header.sequence
    )


def test_used_and_old_frames_are_discarded() -> None:
    frames = Frames()
    for at in range(10):
        frames.add(*depth(at), at)
    third = entry(*depth(3))
    assert frames.find(third) is not None
    frames.discard_through(third)
    assert frames.find(third) is None
    assert len(frames) == 6
    frames.discard_before(8)
    assert len(frames) == 2
    assert frames.find(entry(*depth(9))) is not None


class Fragile:
    """Node that raises at a depth."""

    name = "sensors"
    schedule = Grid(1)
    reads: tuple[type[Message], ...] = (PressureDepth,)
    writes: tuple[type[Message], ...] = (PressureDepth,)

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        if inbox:
            raise ZeroDivisionError(f"at {t_ns}")
        return [PressureDepth(t_ns=t_ns, depth_m=1.0)]


def test_a_step_that_raises_only_in_the_replay_is_a_difference_and_ends_its_epoch() -> None:
    frames, outcome = Frames(), Comparison("sensors", 7)
    frames.add(*depth(0), 0)
    epoch = Epoch(7, Fragile, frames, outcome)
    epoch.take(StepRecord(node="sensors", epoch=7, step=0, steps=(RecordedStep(t_ns=0, cause="grid", inbox=()),)), 1)
    outcome.add_recorded(*depth(0))
    raising = RecordedStep(t_ns=1, cause="grid", inbox=(entry(*depth(0)),))
    epoch.take(
        StepRecord(node="sensors", epoch=7, step=1, steps=(raising, RecordedStep(t_ns=2, cause="grid", inbox=()))), 2
    )
    epoch.close()
    assert (outcome.compared, outcome.identical) == (2, 1)
    assert outcome.first_difference is not None
    assert (outcome.first_difference.step, outcome.first_difference.what) == (
        1,
        "the replay raised ZeroDivisionError: at 1",
    )
    assert epoch.gap is not None
    assert (epoch.gap.first_step, epoch.gap.steps) == (2, 1)


def test_a_missing_input_is_waited_for_up_to_the_largest_distance() -> None:
    frames, outcome = Frames(), Comparison("sensors", 7)
    epoch = Epoch(7, Fragile, frames, outcome)
    epoch.take(
        StepRecord(
            node="sensors", epoch=7, step=0, steps=(RecordedStep(t_ns=0, cause="grid", inbox=(entry(*depth(0)),)),)
        ),
        0,
    )
    epoch.advance(REACH)
    assert epoch.gap is None
    epoch.advance(REACH + 1)
    assert epoch.gap is not None
    assert "sensor/depth 0 (epoch 000000000007" in epoch.gap.why


def ping(sequence: int) -> tuple[StoredMessage, Header]:
    stored, header = depth(sequence)
    return stored._replace(key="sensor/other"), header


def killed(*heard: tuple[StoredMessage, Header]) -> tuple[Epoch, Comparison]:
    """Return an epoch with one recorded step, and outputs after which the file has nothing more of the node."""
    outcome = Comparison("sensors", 7)
    epoch = Epoch(7, Fragile, Frames(), outcome)
    epoch.take(StepRecord(node="sensors", epoch=7, step=0, steps=(RecordedStep(t_ns=0, cause="grid", inbox=()),)), 0)
    for of in heard:
        outcome.add_recorded(*of)
    epoch.close()
    return epoch, outcome


def test_outputs_of_a_step_whose_record_a_new_recorder_has_missed_are_no_difference() -> None:
    """The recorder was away, came back between a record and its outputs, and then the node was killed: of one key the
    next output is there, of another one that comes later.
    """
    epoch, outcome = killed(depth(0), depth(2), ping(0))
    assert outcome.first_difference is None
    assert (outcome.compared, outcome.identical) == (1, 1)
    assert epoch.gap is not None
    assert (epoch.gap.first_step, epoch.gap.steps) == (1, 1)


def test_an_output_that_the_replay_did_not_make_is_a_difference() -> None:
    for heard in ((depth(0), ping(0)), (depth(0), ping(0), ping(1)), (depth(0), depth(1), depth(2))):
        epoch, outcome = killed(*heard)
        assert epoch.gap is None
        assert outcome.first_difference is not None
        assert outcome.first_difference.what == "recorded, but not produced by the replay"
