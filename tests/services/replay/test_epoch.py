"""Epochs: frames kept while a file is read, and a node that raises where the recorded one did not."""

from __future__ import annotations

from functools import partial

import msgspec
import pytest

from ltv_mpc.messages import InboxEntry, Message, PressureDepth, RecordedStep, StepRecord
from ltv_mpc.node import Grid, Inbox
from services.bus import wire
from services.bus.wire import Header
from services.recording.reader import StoredMessage
from services.replay.comparison import Comparison
from services.replay.node_replay import REACH, Epoch, Frames, NodeReplay, frame_of


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


def test_old_frames_are_discarded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.replay.node_replay.MAX_FRAMES", 2)
    replay = NodeReplay("sensors", lambda _: Fragile(), partial(Comparison, "sensors"))
    for at in range(10):
        replay.take(*depth(at), at)
    assert [stored.t_ns for stored in replay._frames.values()] == [8, 9]


def recorded(*inboxes: tuple[InboxEntry, ...], first: int = 0) -> StepRecord:
    """Return the record of steps with these inboxes, from step ``first`` on."""
    steps = (RecordedStep(t_ns=k, cause="grid", inbox=inbox) for k, inbox in enumerate(inboxes, first))
    return StepRecord(node="sensors", epoch=7, step=first, steps=tuple(steps))


def begun() -> tuple[Epoch, Comparison, Frames]:
    """Return an epoch whose first step is recorded."""
    frames, outcome = Frames(), Comparison("sensors", 7)
    epoch = Epoch(7, Fragile, frames, outcome)
    epoch.take(recorded(()), 1)
    return epoch, outcome, frames


def test_a_step_that_raises_only_in_the_replay_is_a_difference_and_ends_its_epoch() -> None:
    epoch, outcome, frames = begun()
    frames[frame_of(entry(*depth(0)))] = depth(0)[0]
    outcome.add_recorded(*depth(0))
    epoch.take(recorded((entry(*depth(0)),), (), first=1), 2)
    epoch.close()
    assert not frames  # it is used
    assert (outcome.compared, outcome.identical) == (2, 1)
    difference = outcome.first_difference
    assert difference is not None
    assert (difference.step, difference.what) == (1, "the replay raised ZeroDivisionError: at 1")
    assert epoch.gap is not None
    assert (epoch.gap.first_step, epoch.gap.steps) == (2, 1)


def test_a_missing_input_is_waited_for_up_to_the_largest_distance() -> None:
    epoch, *_ = begun()
    epoch.take(recorded((entry(*depth(0)),), first=1), 0)
    epoch.advance(REACH)
    assert epoch.gap is None
    epoch.advance(REACH + 1)
    assert epoch.gap is not None
    assert "sensor/depth 0 (epoch 000000000007" in epoch.gap.why


def ping(sequence: int) -> tuple[StoredMessage, Header]:
    stored, header = depth(sequence)
    return stored._replace(key="sensor/other"), header


@pytest.mark.parametrize(
    ("heard", "what", "steps"),
    [
        # A new recorder has missed the record of the second step and came before its outputs: of one key the next
        # output is there, of another one that comes later.
        ((depth(0), depth(2), ping(0)), None, 1),
        *(
            (heard, "recorded, but not produced by the replay", None)
            for heard in ((depth(0), ping(0)), (depth(0), ping(0), ping(1)), (depth(0), depth(1), depth(2)))
        ),
    ],
)
def test_an_output_that_the_replay_did_not_make_is_a_difference_unless_its_record_is_lost(heard, what, steps) -> None:
    """The file has nothing more of the node, which was killed."""
    epoch, outcome, _ = begun()
    for one in heard:
        outcome.add_recorded(*one)
    epoch.close()
    difference = outcome.first_difference
    assert (None if difference is None else difference.what) == what
    assert (None if epoch.gap is None else epoch.gap.steps) == steps
    assert (outcome.compared, outcome.identical) == (1, int(what is None))
