"""Summary of a recording: messages, rate, times and gaps of each key, the run's settings, and whether it is complete.

Only three numbers of each message are read, so a recording of any length takes little memory.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from ltv_mpc.config import loads
from ltv_mpc.messages import Count
from services.bus import topics
from services.bus.wire import Epoch
from services.recording.recover import RECOVERY, RawMessage, SegmentReader
from services.recording.sequence_gaps import SequenceGaps

MAX_EVENTS = 1000
"""Events that are listed; all are counted."""
MAX_GAPS = 20
"""Gaps that are listed of each source."""


class Segment(msgspec.Struct, frozen=True, kw_only=True):
    """File of the recording."""

    file: str
    bytes: int
    whole: bool
    lost_bytes: int
    messages: int
    first_s: float | None
    last_s: float | None


class Source(msgspec.Struct, frozen=True, kw_only=True):
    """Writer of one key: one start of a process."""

    epoch: int
    messages: int
    published: int  # up to the last recorded one
    missing: int
    doubled: int
    gaps: tuple[tuple[int, int], ...]  # first and last missing sequence number, at most MAX_GAPS


class Key(msgspec.Struct, frozen=True, kw_only=True):
    """Messages of one key. Times are vehicle times of publication."""

    key: str
    message: str  # message type; empty if the table of topics has no such key
    messages: int
    rate_hz: float | None  # from the first to the last message; None if that is no time
    first_s: float
    last_s: float
    bytes: int  # as JSON, before compression
    missing: int
    sources: tuple[Source, ...]


class Event(msgspec.Struct, frozen=True, kw_only=True):
    """Run event: a mark on the time axis."""

    t_s: float
    node: str
    kind: str
    text: str


class Info(msgspec.Struct, frozen=True, kw_only=True):
    """Summary of a recording. Entries that the file does not have are "unknown"."""

    recording: str
    scenario: str
    mode: str
    seed: str
    duration_s: float  # from the first message to the last
    made_by: dict[str, str]
    whole: bool
    recovered: bool
    messages: int
    missing: int
    bytes: int
    unreadable: int  # messages without a header
    segments: tuple[Segment, ...]
    keys: tuple[Key, ...]
    events: tuple[Event, ...]
    events_total: int


class _Header(msgspec.Struct):
    epoch: Epoch
    sequence: Count


class _RunEvent(msgspec.Struct):
    t_ns: Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
    node: str
    kind: str
    text: str


class _KeyStatistics:
    def __init__(self) -> None:
        self.first_ns: int | None = None
        self.last_ns = 0
        self.bytes = 0
        self.sources: dict[int, SequenceGaps] = {}

    def add(self, raw: RawMessage, header: _Header) -> None:
        self.first_ns = raw.t_ns if self.first_ns is None else min(self.first_ns, raw.t_ns)
        self.last_ns = max(self.last_ns, raw.t_ns) if self.bytes else raw.t_ns
        self.bytes += len(raw.data)
        self.sources.setdefault(header.epoch, SequenceGaps()).add(header.sequence)


class _Collector:
    def __init__(self) -> None:
        self.keys: dict[str, _KeyStatistics] = {}
        self.events: list[Event] = []
        self.events_total = 0
        self.unreadable = 0
        self._header = msgspec.json.Decoder(_Header).decode
        self._event = msgspec.json.Decoder(_RunEvent).decode

    def add(self, raw: RawMessage) -> None:
        try:
            header = self._header(raw.data)
        except (msgspec.DecodeError, ValueError, RecursionError):
            self.unreadable += 1
            return
        self.keys.setdefault(raw.key, _KeyStatistics()).add(raw, header)
        if raw.key.startswith("event/"):
            self.events_total += 1
            with contextlib.suppress(msgspec.DecodeError, ValueError, RecursionError):
                event = self._event(raw.data)
                if len(self.events) < MAX_EVENTS:
                    self.events.append(Event(t_s=event.t_ns / 1e9, node=event.node, kind=event.kind, text=event.text))


def read(parts: Sequence[Path]) -> Info:
    """Summarise the segments of a recording, in their order. Raises ``ConfigError`` if one is not an MCAP file."""
    collector = _Collector()
    segments: list[Segment] = []
    metadata: dict[str, str] = {}
    recovered = False
    for path in parts:
        reader = SegmentReader(path)
        segments.append(_segment(reader, collector))
        metadata = metadata or reader.metadata
        recovered = recovered or RECOVERY in reader.others
    keys = tuple(_key(name, of) for name, of in sorted(collector.keys.items()))
    first = min((key.first_s for key in keys), default=0.0)
    last = max((key.last_s for key in keys), default=0.0)
    scenario = _scenario(metadata)
    return Info(
        recording=str(parts[0]),
        scenario=_text(scenario, "title"),
        mode=metadata.get("mode", "unknown"),
        seed=metadata.get("seed", "unknown"),
        duration_s=last - first,
        made_by={name: str(value) for name, value in _table(scenario, "made_by").items()},
        whole=all(segment.whole for segment in segments),
        recovered=recovered,
        messages=sum(key.messages for key in keys),
        missing=sum(key.missing for key in keys),
        bytes=sum(segment.bytes for segment in segments),
        unreadable=collector.unreadable,
        segments=tuple(segments),
        keys=keys,
        events=tuple(collector.events),
        events_total=collector.events_total,
    )


def _segment(reader: SegmentReader, collector: _Collector) -> Segment:
    count, first, last = 0, None, None
    for raw in reader:
        count += 1
        first = raw.t_ns if first is None else min(first, raw.t_ns)
        last = raw.t_ns if last is None else max(last, raw.t_ns)
        collector.add(raw)
    records = reader.records
    return Segment(
        file=records.path.name,
        bytes=records.size,
        whole=records.whole,
        lost_bytes=records.lost_bytes,
        messages=count,
        first_s=None if first is None else first / 1e9,
        last_s=None if last is None else last / 1e9,
    )


def _key(name: str, of: _KeyStatistics) -> Key:
    topic = topics.topic_at(name)
    messages = sum(gaps.messages for gaps in of.sources.values())
    first_ns = of.first_ns or 0
    over_ns = of.last_ns - first_ns
    return Key(
        key=name,
        message="" if topic is None else topic.message_type.__name__,
        messages=messages,
        rate_hz=1e9 * (messages - 1) / over_ns if over_ns > 0 else None,
        first_s=first_ns / 1e9,
        last_s=of.last_ns / 1e9,
        bytes=of.bytes,
        missing=sum(gaps.missing for gaps in of.sources.values()),
        sources=tuple(
            Source(
                epoch=epoch,
                messages=gaps.messages,
                published=gaps.published,
                missing=gaps.missing,
                doubled=gaps.doubled,
                gaps=gaps.ranges[:MAX_GAPS],
            )
            for epoch, gaps in of.sources.items()
        ),
    )


def _scenario(metadata: dict[str, str]) -> dict[str, Any]:
    try:
        return loads(metadata.get("scenario.toml", ""))
    except (ValueError, RecursionError):
        return {}


def _table(scenario: dict[str, Any], name: str) -> dict[str, Any]:
    table = scenario.get(name)
    return table if isinstance(table, dict) else {}


def _text(scenario: dict[str, Any], name: str) -> str:
    value = scenario.get(name)
    return value if isinstance(value, str) and value else "unknown"
