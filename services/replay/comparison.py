"""Replayed outputs against recorded ones: the bytes on the wire, under the recorded header.

The file holds JSON, which keeps every finite number exactly and tells 1 from 1.0, and the CRC-32 of the frame; both
must be those of the replayed signal. What the file holds twice, or in a damaged copy beside the right one, is identical
if one of the copies is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import msgspec

from ltv_mpc.messages import Message
from services.bus import wire
from services.bus.topics import key_of
from services.recording.reader import StoredMessage
from services.replay.epoch import Record
from services.replay.frames import Header
from services.replay.verdict import MAX_FIELDS, Difference, FieldDifference, Gap

MAX_RIVALS = 1000
"""Outputs that wait for a copy which is identical; beyond, the oldest has had its time."""

NOT_MADE = "recorded, not made by the replay"
NOT_RECORDED = "made by the replay, not recorded"


class _Output(NamedTuple):
    step: int
    t_ns: int
    signal: Message


class Comparison:
    """Of one epoch. Each key's outputs are numbered from 0, as they were when they were published."""

    def __init__(self, node: str, epoch: int) -> None:
        self.first_difference: Difference | None = None
        self.steps = 0  # that were replayed
        self.compared = 0  # outputs
        self.lost = 0
        self.unpublished = 0
        self._node = node
        self._epoch = epoch
        self._different: set[int] = set()  # steps
        self._incomplete: set[int] = set()  # steps of which an output was lost
        self._made: dict[tuple[str, int], _Output] = {}  # and not recorded yet
        self._rivals: dict[
            tuple[str, int], tuple[StoredMessage, Header]
        ] = {}  # other than what was made; a copy may follow
        self._recorded: dict[tuple[str, int], list[tuple[StoredMessage, Header]]] = {}  # and not made yet
        self._count: dict[str, int] = {}  # made so far
        self._newest: dict[str, int] = {}  # highest sequence recorded
        self._stopped = False
        self._last = (-1, 0)  # step and time of the newest record

    @property
    def steps_compared(self) -> int:
        """Replayed steps all of whose outputs are in the file."""
        return self.steps - len(self._incomplete)

    @property
    def steps_identical(self) -> int:
        """Those of them that made the same bytes."""
        return self.steps - len(self._incomplete | self._different)

    @property
    def behind(self) -> bool:
        """Whether the file holds outputs of later steps than were replayed: the next of one key, and of another one
        that comes after one which is not in the file. A recorder that has just come back hears both, but no records.
        """
        first: dict[str, int] = {}
        for key, sequence in self._recorded:
            first[key] = min(sequence, first.get(key, sequence))
        next_ones = [sequence == self._count.get(key, 0) for key, sequence in first.items()]
        return any(next_ones) and not all(next_ones)

    def add_replayed(self, record: Record, signals: Sequence[Message]) -> None:
        """A step made these."""
        self.steps += 1
        self._last = record.step, record.t_ns
        for entry in record.inbox:
            if entry.epoch == record.epoch:  # from the node's own process: the state that it began from
                self._count[entry.key] = entry.sequence + 1
                self._recorded.pop((entry.key, entry.sequence), None)
        for signal in signals:
            key = key_of(type(signal), self._node)
            sequence = self._count.get(key, 0)
            self._count[key] = sequence + 1
            self._made[key, sequence] = _Output(record.step, record.t_ns, signal)
            for stored, header in self._recorded.pop((key, sequence), ()):
                self._settle(key, sequence, stored, header)

    def step_failed(self, record: Record, error: Exception) -> None:
        """A step that has a record, and so was survived, ended like this."""
        self.steps += 1
        what = f"the replay raised {type(error).__name__}: {error}"
        self._differs(_Output(record.step, record.t_ns, Message()), "", -1, what)

    def add_recorded(self, stored: StoredMessage, header: Header) -> None:
        """The file holds this output of the epoch."""
        key, sequence = stored.key, header.sequence
        if sequence > self._newest.get(key, -1):
            self._newest[key] = sequence
        if sequence < self._count.get(key, 0):
            self._settle(key, sequence, stored, header)
        elif not self._stopped:
            self._recorded.setdefault((key, sequence), []).append((stored, header))

    def stop(self) -> None:
        """After a gap: what is recorded from here on has no counterpart, and is not kept."""
        self._stopped = True
        self._recorded.clear()

    def close(self, gap: Gap | None) -> None:
        """Nothing more comes: what has no counterpart is a difference, a loss, or was never published."""
        for name in list(self._rivals):
            self._give_up(name)
        whole = gap is None
        open_step = max((output.step for output in self._made.values()), default=-1)
        for (key, sequence), output in self._made.items():
            if sequence > self._newest.get(key, -1) and output.step == open_step:
                self.unpublished += 1
            elif sequence > self._newest.get(key, -1) and whole and not self._any_hole():
                self._differs(output, key, sequence, NOT_RECORDED)
            else:
                self.lost += 1
                self._incomplete.add(output.step)
        for key, sequence in self._recorded:
            if whole and sequence == self._count.get(key, 0):
                self._differs(_Output(*self._last, Message()), key, sequence, NOT_MADE)

    def _any_hole(self) -> bool:
        """Whether the file misses an output that something of the same key comes behind."""
        return any(sequence < self._newest.get(key, -1) for key, sequence in self._made)

    def _settle(self, key: str, sequence: int, stored: StoredMessage, header: Header) -> None:
        output = self._made.get((key, sequence))
        if output is None:
            return  # a copy of what was found identical
        plain = wire.to_map(output.signal, header)
        if msgspec.json.encode(plain) == stored.data and wire.crc(wire.pack(plain)) == stored.crc:
            del self._made[key, sequence]
            self._rivals.pop((key, sequence), None)
            self.compared += 1
        else:
            self._rivals.setdefault((key, sequence), (stored, header))
            if len(self._rivals) > MAX_RIVALS:
                self._give_up(next(iter(self._rivals)))

    def _give_up(self, name: tuple[str, int]) -> None:
        stored, header = self._rivals.pop(name)
        output = self._made.pop(name)
        self.compared += 1
        self._differs(output, *name, "", _fields(_json(output.signal, header), stored.data))

    def _differs(
        self, output: _Output, key: str, sequence: int, what: str, fields: Sequence[FieldDifference] = ()
    ) -> None:
        self._different.add(output.step)
        if self.first_difference is not None and self.first_difference.step <= output.step:
            return
        self.first_difference = Difference(
            node=self._node,
            epoch=self._epoch,
            step=output.step,
            t_ns=output.t_ns,
            key=key,
            sequence=sequence,
            what=what or ("" if fields else "equal values in another encoding: the CRC-32 of the frame differs"),
            fields=tuple(fields[:MAX_FIELDS]),
            more_fields=max(0, len(fields) - MAX_FIELDS),
        )


def _json(signal: Message, header: Header) -> bytes:
    return msgspec.json.encode(wire.to_map(signal, header))


def _fields(replayed: bytes, recorded: bytes) -> list[FieldDifference]:
    return list(differences(msgspec.json.decode(recorded), msgspec.json.decode(replayed)))


def differences(recorded: Any, replayed: Any, path: str = "") -> Iterator[FieldDifference]:
    """Every value of two plain maps that is not the same, 1 and 1.0 being two; by path, in the recorded order."""
    if isinstance(recorded, dict) and isinstance(replayed, dict):
        for name in dict.fromkeys((*recorded, *replayed)):
            inner = f"{path}.{name}" if path else str(name)
            yield from differences(recorded.get(name), replayed.get(name), inner)
    elif isinstance(recorded, list) and isinstance(replayed, list) and len(recorded) == len(replayed):
        for i, (was, is_) in enumerate(zip(recorded, replayed, strict=True)):
            yield from differences(was, is_, f"{path}[{i}]")
    elif msgspec.json.encode(recorded) != msgspec.json.encode(replayed):
        yield FieldDifference(path=path, recorded=recorded, replayed=replayed)
