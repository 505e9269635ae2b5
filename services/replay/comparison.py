"""Comparison of replayed with recorded outputs: the bytes of the frame, under the recorded header.

The file has the message as JSON, which keeps every finite number exactly and distinguishes 1 from 1.0, and the CRC-32
of the frame; both must be equal. If the file has duplicates or damaged copies of an output, one identical copy
suffices.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import msgspec

from ltv_mpc.messages import Message, RecordedStep
from services.bus import wire
from services.bus.topics import key_of
from services.bus.wire import Header
from services.recording.reader import StoredMessage
from services.replay.verdict import MAX_FIELDS, Difference, FieldDifference, Gap

MAX_PENDING = 1000
"""Different outputs that wait for an identical copy; beyond that number the oldest counts as different."""

NOT_REPLAYED = "recorded, but not produced by the replay"
NOT_RECORDED = "produced by the replay, but not recorded"
SAME_VALUES = "equal values in another encoding: the CRC-32 of the frame differs"

_Name: TypeAlias = tuple[str, int]
"""Key and sequence number of an output."""


class _Output(NamedTuple):
    step: int
    t_ns: int
    message: Message


class Comparison:
    """Matching of the replayed and recorded outputs of one epoch.

    The replayed outputs of each key are numbered from 0, as they were when they were published.
    """

    def __init__(self, node: str, epoch: int) -> None:
        self.first_difference: Difference | None = None
        self.replayed = 0  # steps
        self.outputs: Counter[str] = Counter()
        """Numbers of outputs that are compared, lost and unpublished."""
        self._node, self._epoch = node, epoch
        self._different_steps: set[int] = set()
        self._incomplete_steps: set[int] = set()  # with a lost output
        self._replayed: dict[_Name, _Output] = {}  # not recorded yet
        self._recorded: dict[_Name, list[tuple[StoredMessage, Header]]] = {}  # not replayed yet
        self._different: dict[_Name, tuple[StoredMessage, Header]] = {}  # an identical copy may follow
        self._next: dict[str, int] = {}  # sequence number of the next replayed output
        self._newest: dict[str, int] = {}  # highest recorded sequence number
        self._stopped = False
        self._last = (-1, 0)  # step and time of the newest record

    @property
    def compared(self) -> int:
        """Replayed steps all of whose outputs are in the file."""
        return self.replayed - len(self._incomplete_steps)

    @property
    def identical(self) -> int:
        """Compared steps whose outputs are identical."""
        return self.replayed - len(self._incomplete_steps | self._different_steps)

    @property
    def behind(self) -> bool:
        """True if the file has outputs of later steps than were replayed.

        It has, if the next output of one key is recorded, and of another key only a later one. A restarted recorder
        receives such outputs, but not the records of their steps.
        """
        first: dict[str, int] = {}
        for key, sequence in self._recorded:
            first[key] = min(sequence, first.get(key, sequence))
        next_ones = [sequence == self._next.get(key, 0) for key, sequence in first.items()]
        return any(next_ones) and not all(next_ones)

    def add_replayed(self, number: int, step: RecordedStep, messages: Sequence[Message]) -> None:
        """Add the outputs of a replayed step."""
        self.replayed += 1
        self._last = number, step.t_ns
        for entry in step.inbox:
            if entry.epoch == self._epoch:  # from the node's own process: the state that it started from
                self._next[entry.key] = entry.sequence + 1
                self._recorded.pop((entry.key, entry.sequence), None)
        for message in messages:
            key = key_of(type(message), self._node)
            sequence = self._next.get(key, 0)
            self._next[key] = sequence + 1
            self._replayed[key, sequence] = _Output(number, step.t_ns, message)
            for stored, header in self._recorded.pop((key, sequence), ()):
                self._compare((key, sequence), stored, header)

    def step_failed(self, number: int, step: RecordedStep, error: Exception) -> None:
        """Add a replayed step that raised. The recorded one did not, because the node survived it."""
        self.replayed += 1
        what = f"the replay raised {type(error).__name__}: {error}"
        self._add_difference(_Output(number, step.t_ns, Message()), "", -1, what)

    def add_recorded(self, stored: StoredMessage, header: Header) -> None:
        """Add a recorded output of the epoch."""
        key, sequence = stored.key, header.sequence
        if sequence > self._newest.get(key, -1):
            self._newest[key] = sequence
        if sequence < self._next.get(key, 0):
            self._compare((key, sequence), stored, header)
        elif not self._stopped:
            self._recorded.setdefault((key, sequence), []).append((stored, header))

    def stop(self) -> None:
        """Note a gap: later recorded outputs have no counterpart and are not kept."""
        self._stopped = True
        self._recorded.clear()

    def close(self, gap: Gap | None) -> None:
        """Classify the outputs without a counterpart: as a difference, as lost, or as never published."""
        for name in list(self._different):
            self._count_difference(name)
        complete = gap is None
        last_step = max((output.step for output in self._replayed.values()), default=-1)
        # The file misses an output behind which it has a later one of the same key.
        has_hole = any(sequence < self._newest.get(key, -1) for key, sequence in self._replayed)
        for (key, sequence), output in self._replayed.items():
            if sequence > self._newest.get(key, -1) and output.step == last_step:
                self.outputs["unpublished"] += 1
            elif sequence > self._newest.get(key, -1) and complete and not has_hole:
                self._add_difference(output, key, sequence, NOT_RECORDED)
            else:
                self.outputs["lost"] += 1
                self._incomplete_steps.add(output.step)
        for key, sequence in self._recorded:
            if complete and sequence == self._next.get(key, 0):
                self._add_difference(_Output(*self._last, Message()), key, sequence, NOT_REPLAYED)

    def _compare(self, name: _Name, stored: StoredMessage, header: Header) -> None:
        output = self._replayed.get(name)
        if output is None:
            return  # a copy of an output that is identical
        plain = wire.to_map(output.message, header)
        if msgspec.json.encode(plain) == stored.data and wire.crc(wire.pack(plain)) == stored.crc:
            del self._replayed[name]
            self._different.pop(name, None)
            self.outputs["compared"] += 1
        else:
            self._different.setdefault(name, (stored, header))
            if len(self._different) > MAX_PENDING:
                self._count_difference(next(iter(self._different)))

    def _count_difference(self, name: _Name) -> None:
        stored, header = self._different.pop(name)
        output = self._replayed.pop(name)
        self.outputs["compared"] += 1
        replayed = msgspec.json.encode(wire.to_map(output.message, header))
        fields = differences(msgspec.json.decode(stored.data), msgspec.json.decode(replayed))
        self._add_difference(output, *name, "", tuple(fields))

    def _add_difference(
        self, output: _Output, key: str, sequence: int, what: str, fields: tuple[FieldDifference, ...] = ()
    ) -> None:
        """Add a difference; the one of the earliest step is kept."""
        self._different_steps.add(output.step)
        if self.first_difference is not None and self.first_difference.step <= output.step:
            return
        self.first_difference = Difference(
            node=self._node,
            epoch=self._epoch,
            step=output.step,
            t_ns=output.t_ns,
            key=key,
            sequence=sequence,
            what=what or ("" if fields else SAME_VALUES),
            fields=fields[:MAX_FIELDS],
            more_fields=max(0, len(fields) - MAX_FIELDS),
        )


def differences(recorded: Any, replayed: Any, path: str = "") -> Iterator[FieldDifference]:
    """Yield every value that differs between two plain maps, by path in the recorded order; 1 and 1.0 differ."""
    if isinstance(recorded, dict) and isinstance(replayed, dict):
        for name in dict.fromkeys((*recorded, *replayed)):
            inner = f"{path}.{name}" if path else str(name)
            yield from differences(recorded.get(name), replayed.get(name), inner)
    elif isinstance(recorded, list) and isinstance(replayed, list) and len(recorded) == len(replayed):
        for i, (was, is_) in enumerate(zip(recorded, replayed, strict=True)):
            yield from differences(was, is_, f"{path}[{i}]")
    elif msgspec.json.encode(recorded) != msgspec.json.encode(replayed):
        yield FieldDifference(path=path, recorded=recorded, replayed=replayed)
