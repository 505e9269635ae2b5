"""Text output of ``ltv-mpc log``: contents of a recording, result of a recovery or an export."""

from __future__ import annotations

from collections.abc import Iterable

from ltv_mpc.errors import one_line
from services.bus.topics import topic_at
from services.recording.export import ExportResult
from services.recording.info import Info, Key
from services.recording.recover import Recovery, Segment
from services.recording.writer import VEHICLE_MODE
from services.runtime.console import columns, counted, fold

MAX_EVENTS = 20
"""Number of events that are printed; --json lists all of them."""

SILENT_PERIODS, MIN_SILENCE_S = 5, 1.0
"""A key with a period is silent after so many periods, and not before so many seconds."""


def text(info: Info) -> str:
    """Format the contents of a recording: source, duration, completeness, a line for each key, gaps and events."""
    vehicle = info.mode == VEHICLE_MODE
    since_s = info.start_s if vehicle else 0.0
    lines = [fold(f"{info.recording}: {f'vehicle {info.vehicle}' if vehicle else info.scenario}")]
    if info.why:
        lines.append(fold(one_line(f"The run failed: {info.why}")))
    versions = info.made_by
    packages = ("ltv_mpc", "python", "numpy", "osqp", "numba")
    by = ", ".join(f"{name} {versions[name]}" for name in packages if name in versions)
    first = f"start {info.start_utc or f'at {info.start_s:.3f} s'} by the vehicle's own clock"  # others count from it
    how = first if vehicle else f"mode {info.mode}, seed {info.seed}"
    lines.append(fold(f"{how}, {info.duration_s:.1f} s{'; ' if by else ''}{by}"))
    lines += [_segment(segment, since_s) for segment in info.segments]
    unreadable = f", {info.unreadable} without a header" if info.unreadable else ""
    lines.append(f"{counted(info.messages, 'message')}, {info.missing or 'none'} missing{unreadable}")
    lines += ["", *columns([_HEAD, *(_row(key, since_s) for key in info.keys)], numbers=True)]
    for title, of_key in (("keys with several sources", _sources), ("longest silences", _silences), ("gaps", _gaps)):
        if found := [line for key in info.keys for line in of_key(key, since_s)]:
            lines += ["", title, *found]
    if info.events:
        shown = info.events[:MAX_EVENTS]
        lines += ["", f"events ({info.events_total})"]
        lines += [f"  {event.t_s - since_s:9.2f} s  {event.node}: {event.kind}: {event.text}" for event in shown]
        if info.events_total > len(shown):
            lines.append(f"  ... {info.events_total - len(shown)} more")
    if not info.whole:
        lines += ["", "incomplete: `ltv-mpc log recover RUN` writes the readable messages into a complete file"]
    return "\n".join(lines)


def recovered(recovery: Recovery) -> str:
    """Format the result of a recovery: messages saved and bytes lost."""
    lines = []
    for part in recovery.segments:
        state = "complete" if part.whole else f"{part.lost_bytes} bytes lost"
        lines.append(f"{part.file}: {counted(part.messages, 'message')} saved, {state} of {part.bytes}")
        lines += [f"  byte {loss.offset}: {loss.length} bytes: {loss.why}" for loss in part.losses]
        if part.orphans:
            lines.append(f"  {counted(part.orphans, 'message')} left out: their channel record is lost")
    lines.append(f"{counted(recovery.messages, 'message')} saved, {recovery.lost_bytes} bytes lost")
    return "\n".join(lines)


def exported(result: ExportResult) -> str:
    """Format the result of an export: files and the number of their rows."""
    rows = [(file.file, str(file.rows), str(file.columns)) for file in result.files]
    lines = columns([("file", "rows", "columns"), *rows], numbers=True)
    if result.unreadable:
        lines.append(f"{counted(result.unreadable, 'message')} left out: their content does not match their key")
    return "\n".join(lines)


_HEAD = ("key", "messages", "rate/s", "first s", "last s", "kB", "missing", "starts")


def _row(key: Key, since_s: float) -> tuple[str, ...]:
    rate = "-" if key.rate_hz is None else f"{key.rate_hz:.4g}"
    size = f"{key.bytes / 1e3:.1f}"
    times = f"{key.first_s - since_s:.2f}", f"{key.last_s - since_s:.2f}"
    return (key.key, str(key.messages), rate, *times, size, str(key.missing or "-"), str(len(key.sources)))


def _segment(segment: Segment, since_s: float) -> str:
    times = ""
    if segment.first_s is not None and segment.last_s is not None:
        times = f", {segment.first_s - since_s:.1f} to {segment.last_s - since_s:.1f} s"
    state = "complete" if segment.whole else f"INCOMPLETE, {segment.lost_bytes} bytes unreadable"
    return f"{segment.file}: {segment.bytes / 1e6:.2f} MB, {counted(segment.messages, 'message')}{times}, {state}"


def _sources(key: Key, since_s: float) -> Iterable[str]:
    if len(key.sources) > 1:
        for source in key.sources:
            times = f"{source.first_s - since_s:.2f} to {source.last_s - since_s:.2f} s"
            yield f"  {key.key}, epoch {source.epoch}: {counted(source.messages, 'message')}, {times}"


def _silences(key: Key, since_s: float) -> Iterable[str]:
    topic = topic_at(key.key)
    period_s = 0.0 if topic is None else topic.period_ns / 1e9
    if period_s and key.silence_s > max(MIN_SILENCE_S, SILENT_PERIODS * period_s):
        yield f"  {key.key}: {key.silence_s:.2f} s without a message, from {key.silence_from_s - since_s:.2f} s on"


def _gaps(key: Key, _since_s: float) -> Iterable[str]:
    for source in key.sources:
        words = []
        if source.missing:
            listed = ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in source.gaps)
            words += [f"{source.missing} of {source.published}", f"sequence {listed}"]
        if source.doubled:
            words.append(f"{source.doubled} duplicated")
        if words:
            yield f"  {key.key}, epoch {source.epoch}: {'; '.join(words)}"
