"""Summary of a recording: messages, rate, times and gaps of each key, the run's settings, and whether it is complete.

Only three numbers of each message are read, so a recording of any length takes little memory.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from ltv_mpc.messages import NodeSettings, RunEvent
from services.bus import topics
from services.bus.roles import SUPERVISOR
from services.bus.wire import Header, WireError
from services.recording.loss_accounting import SequenceGaps
from services.recording.node_settings import SCENARIO, table_of, vehicle_name
from services.recording.reader import Recording, StoredMessage
from services.recording.recover import RECOVERY
from services.recording.writer import ENDED, VEHICLE_MODE

SUPERVISOR_EVENTS = topics.key_of(RunEvent, SUPERVISOR)
MAX_EVENTS = 1000
"""Events that are listed; all are counted."""
MAX_SOURCES = 1_000
"""Sources of a key that are listed; messages of others count as unreadable."""
MAX_GAPS = 20
"""Gaps that are listed of each source."""
FIRST_DATE_S, LAST_DATE_S = 946_684_800.0, 4_102_444_800.0
"""2000 and 2100: times between them count from 1970. A clock that counts from its boot is far below."""


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
    first_s: float
    last_s: float
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
    silence_s: float  # longest time between two messages
    silence_from_s: float
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
    vehicle: str  # name in its file
    mode: str
    seed: str
    start_s: float  # time of the first message
    start_utc: str | None  # the same as a date, if the vehicle's clock counts from 1970
    duration_s: float  # from the first message to the last
    made_by: dict[str, str]
    whole: bool
    recovered: bool
    messages: int
    missing: int
    bytes: int
    unreadable: int  # messages without a header
    why: str  # why the run ended early; empty if it did not, or nothing says so
    segments: tuple[Segment, ...]
    keys: tuple[Key, ...]
    events: tuple[Event, ...]
    events_total: int


class _Span:
    """First and last time of some messages."""

    def __init__(self, t_ns: int) -> None:
        self.first_ns = self.last_ns = t_ns

    def add(self, t_ns: int) -> None:
        """Add the time of a message, in any order."""
        self.first_ns, self.last_ns = min(self.first_ns, t_ns), max(self.last_ns, t_ns)


class _KeyFigures(_Span):
    def __init__(self, t_ns: int) -> None:
        super().__init__(t_ns)
        self._bytes = 0
        self._silence_ns, self._silence_from_ns = 0, 0
        self._sources: dict[int, tuple[SequenceGaps, _Span]] = {}  # by epoch

    def add_message(self, raw: StoredMessage, header: Header, *, from_first: bool) -> None:
        """Add a message. ``from_first``: a source is counted from its first recorded message on, not from 0."""
        if raw.t_ns - self.last_ns > self._silence_ns:
            self._silence_ns, self._silence_from_ns = raw.t_ns - self.last_ns, self.last_ns
        self.add(raw.t_ns)
        self._bytes += len(raw.data)
        if header.epoch not in self._sources:
            if len(self._sources) >= MAX_SOURCES:
                raise WireError("too many sources")
            self._sources[header.epoch] = SequenceGaps(header.sequence if from_first else 0), _Span(raw.t_ns)
        gaps, span = self._sources[header.epoch]
        gaps.add(header.sequence)
        span.add(raw.t_ns)

    def key(self, name: str) -> Key:
        """Return the figures for the output."""
        sources = tuple(
            Source(
                epoch=epoch,
                messages=gaps.received + gaps.doubled,
                first_s=span.first_ns / 1e9,
                last_s=span.last_ns / 1e9,
                published=gaps.published,
                missing=gaps.missing,
                doubled=gaps.doubled,
                gaps=gaps.ranges[:MAX_GAPS],
            )
            for epoch, (gaps, span) in self._sources.items()
        )
        topic, over_ns = topics.topic_at(name), self.last_ns - self.first_ns
        messages = sum(source.messages for source in sources)
        return Key(
            key=name,
            message="" if topic is None else topic.message_type.__name__,
            messages=messages,
            rate_hz=1e9 * (messages - 1) / over_ns if over_ns > 0 else None,
            first_s=self.first_ns / 1e9,
            last_s=self.last_ns / 1e9,
            silence_s=self._silence_ns / 1e9,
            silence_from_s=self._silence_from_ns / 1e9,
            bytes=self._bytes,
            missing=sum(source.missing for source in sources),
            sources=sources,
        )


class _Collector:
    def __init__(self) -> None:
        self.keys: dict[str, _KeyFigures] = {}
        self.events: list[Event] = []
        self.events_total = 0
        self.why = ""
        self.unreadable = 0
        self.settings: dict[str, NodeSettings] = {}  # newest, by key

    def read(self, recording: Recording) -> Segment:
        """Read a segment to its end."""
        messages = 0
        span: _Span | None = None
        for stored in recording.stored():
            messages += 1
            span = span or _Span(stored.t_ns)
            span.add(stored.t_ns)
            self._add(stored, from_first=recording.metadata.get("mode") == VEHICLE_MODE)
        (records,) = recording.parts
        return Segment(
            file=records.path.name,
            bytes=records.size,
            whole=records.whole,
            lost_bytes=records.lost_bytes,
            messages=messages,
            first_s=None if span is None else span.first_ns / 1e9,
            last_s=None if span is None else span.last_ns / 1e9,
        )

    def _add(self, stored: StoredMessage, *, from_first: bool) -> None:
        """Add a message; ``from_first`` as in ``_KeyFigures.add_message``."""
        try:
            header = stored.header()
            figures = self.keys.setdefault(stored.key, _KeyFigures(stored.t_ns))
            figures.add_message(stored, header, from_first=from_first)
        except WireError:
            self.unreadable += 1
            return
        self.events_total += stored.kind is RunEvent
        if stored.kind not in (NodeSettings, RunEvent):
            return
        with contextlib.suppress(WireError):
            match stored.message():
                case NodeSettings() as settings:
                    self.settings[stored.key] = settings
                case RunEvent(t_ns=t_ns, node=node, kind=kind, text=text) if len(self.events) < MAX_EVENTS:
                    self.events.append(Event(t_s=t_ns / 1e9, node=node, kind=kind, text=text))
                    if kind == ENDED and stored.key == SUPERVISOR_EVENTS:
                        self.why = text


def read(parts: Sequence[Path]) -> Info:
    """Summarise the segments of a recording, in their order. Raises ``ConfigError`` if one is not an MCAP file."""
    collector = _Collector()
    recordings = [Recording(path) for path in parts]
    segments = tuple(map(collector.read, recordings))
    metadata = next((recording.metadata for recording in recordings if recording.metadata), {})
    keys = tuple(figures.key(name) for name, figures in sorted(collector.keys.items()))
    first = min((key.first_s for key in keys), default=0.0)
    last = max((key.last_s for key in keys), default=0.0)
    scenario = table_of(metadata, SCENARIO)
    title, provenance = scenario.get("title"), scenario.get("made_by")
    published = {name: text for settings in collector.settings.values() for name, text in settings.files.items()}
    if not (isinstance(provenance, dict) and provenance):
        provenance = next((settings.made_by for settings in collector.settings.values()), {})
    return Info(
        recording=str(parts[0]),
        scenario=title if isinstance(title, str) and title else "unknown",
        vehicle=vehicle_name({**metadata, **published}),
        mode=metadata.get("mode", "unknown"),
        seed=metadata.get("seed", "unknown"),
        start_s=first,
        start_utc=utc(first) if metadata.get("mode") == VEHICLE_MODE else None,
        duration_s=last - first,
        made_by={name: str(value) for name, value in provenance.items()},
        whole=all(segment.whole for segment in segments),
        recovered=any(RECOVERY in recording.others for recording in recordings),
        messages=sum(key.messages for key in keys),
        missing=sum(key.missing for key in keys),
        bytes=sum(segment.bytes for segment in segments),
        unreadable=collector.unreadable,
        why=collector.why,
        segments=segments,
        keys=keys,
        events=tuple(collector.events),
        events_total=collector.events_total,
    )


def utc(t_s: float) -> str | None:
    """Return a time since 1970 as a date in UTC; None if a clock that counts from 1970 would not read it today."""
    if not FIRST_DATE_S <= t_s <= LAST_DATE_S:
        return None
    return datetime.fromtimestamp(t_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
