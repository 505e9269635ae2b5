"""Plot data of a recorded run, also from a recording that was cut off."""

from __future__ import annotations

import contextlib
from itertools import chain
from pathlib import Path
from typing import Any

import msgspec
from mcap.records import Channel, Metadata
from mcap.records import Message as McapMessage

from ltv_mpc.messages import (
    Acknowledgement,
    Applied,
    Clock,
    Command,
    ControllerStatus,
    CycleTiming,
    Estimate,
    FenceInForce,
    LocalisationReport,
    Message,
    NodeSettings,
    NodeStatus,
    Plan,
    RunEvent,
    Truth,
)
from services.bus import topics, wire
from services.recording.node_settings import vehicle_of
from services.recording.records import Records, start_of
from services.recording.recover import segments
from services.recording.writer import RUN, VEHICLE_MODE
from services.reporting.plots import analysis
from services.reporting.plots.collector import ROWS, Collector
from services.reporting.plots.events import Mark
from services.reporting.plots.table import Columns
from services.reporting.safety import RunSafety

RARE = frozenset(
    (
        *(Plan, FenceInForce, CycleTiming, Clock, RunEvent, LocalisationReport, NodeStatus, NodeSettings, Command),
        Acknowledgement,
        ControllerStatus,
    )
)
OFTEN = {Truth: 200_000_000, Estimate: 200_000_000, Applied: 200_000_000}
"""Vehicle time (ns) between two decoded messages of these types; it grows with the length of the run."""


class PlotData(msgspec.Struct, frozen=True, kw_only=True):
    """Plot data of one run: tables by name and column, values of levels, event marks."""

    tables: dict[str, Columns]
    values: dict[str, float]
    marks: tuple[Mark, ...]
    omitted_marks: int
    start_s: float  # vehicle time of the first message beside a vehicle, from which all times count; otherwise 0
    safety: RunSafety
    cut: bool  # the recording is incomplete, usually at its end
    metadata: dict[str, str]  # of the recording, with the settings files that processes published


class _When(msgspec.Struct):
    """Time and source of a message: the only fields that are decoded for each message."""

    t_ns: int
    epoch: int


class _Sieve:
    """Decimator: accepts one message in each ``period_ns``, which doubles to keep fewer than ``2 * limit`` rows."""

    def __init__(self, period_ns: int, limit: int) -> None:
        self._period_ns = period_ns
        self._limit = limit
        self._passed = 0
        self._next_ns: int | None = None

    def passes(self, t_ns: int) -> bool:
        if self._next_ns is not None and self._next_ns - self._period_ns <= t_ns < self._next_ns:
            return False
        self._next_ns = (t_ns // self._period_ns + 1) * self._period_ns
        self._passed += 1
        if self._passed == 2 * self._limit:
            self._passed, self._period_ns = self._limit, 2 * self._period_ns
        return True


def read(recording: Path, *, rows: int = ROWS) -> PlotData:
    """Read the plot data in one pass over the recording and its segments, decoding only the plotted messages.

    Invalid messages are skipped, as their readers did. Raises ``ConfigError`` if the file is not a recording.
    """
    parts = [Records(path) for path in segments(recording)]
    decode, when = msgspec.json.Decoder(dict[str, Any]).decode, msgspec.json.Decoder(_When).decode
    kinds: dict[int, type[Message] | None] = {}
    sieves: dict[tuple[type[Message], int], _Sieve] = {}  # by type and source: each source has rows of its own
    metadata: dict[str, str] = {}
    files: dict[str, str] = {}  # of the processes that published their settings
    start_ns = 0
    safety = RunSafety()
    collector: Collector | None = None
    newest: dict[str, Any] | None = None
    source_epoch = 0  # of the estimates in use; 0: unknown
    for record in chain.from_iterable(parts):
        if isinstance(record, McapMessage):
            kind = kinds[record.channel_id]
            if kind is None:
                continue
            try:
                if kind in OFTEN:
                    passing = when(record.data)
                    sieve = sieves.setdefault((kind, passing.epoch), _Sieve(OFTEN[kind], rows))
                    if not sieve.passes(passing.t_ns):
                        continue
                whole = decode(record.data)
                # The profile of the current is the largest part, and only the last one is drawn.
                plain = {**whole, "current": None} if kind is Estimate else whole
                message, header = wire.from_map(kind, plain)
            except (wire.WireError, msgspec.DecodeError):
                continue
            if collector is None:
                start_ns = record.log_time + start_of(metadata) if metadata.get("mode") == VEHICLE_MODE else 0
                collector = Collector(vehicle_of(metadata), rows=rows, origin_ns=start_ns)
            if isinstance(message, ControllerStatus):
                source_epoch = message.source_epoch
            elif kind is not Estimate or source_epoch in (0, header.epoch):  # else it is of a source not in use
                collector.add(message, header.epoch)
                newest = whole if kind is Estimate else newest
            safety.add(message, header.epoch)
            if isinstance(message, NodeSettings):
                files |= message.files
        elif isinstance(record, Channel):
            kinds[record.id] = _shown_type(record.topic)
        elif isinstance(record, Metadata) and record.name == RUN:
            metadata = record.metadata
    metadata = {**files, **metadata}
    collector = collector or Collector(rows=rows)
    collector.set_vehicle(vehicle_of(metadata))
    if newest is not None:
        with contextlib.suppress(wire.WireError):
            collector.newest.profile = wire.from_map(Estimate, newest)[0].current
    return PlotData(
        tables=analysis.tables(collector.all_tables()),
        values=collector.values,
        marks=tuple(collector.marks.marks),
        omitted_marks=collector.marks.omitted,
        start_s=start_ns / 1e9,
        safety=safety,
        cut=not all(part.whole for part in parts),
        metadata=metadata,
    )


def _shown_type(key: str) -> type[Message] | None:
    """Return the message type of a key if a report shows it."""
    topic = topics.topic_at(key)
    return topic.message_type if topic is not None and topic.message_type in (*RARE, *OFTEN) else None
