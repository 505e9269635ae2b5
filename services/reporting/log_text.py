"""A recording in figures, for people: the table of ``ltv-mpc log info``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from services.recording.export import ExportResult
from services.recording.info import Info, Key, Segment
from services.recording.perfetto import TraceSummary
from services.recording.recover import Recovery

MAX_EVENTS = 20
"""That are printed; --json has more."""


def text(info: Info) -> str:
    """Of what, how long, whether whole; a line a key; gaps; events."""
    lines = [f"{info.recording}: {info.scenario}"]
    made = info.made_by
    by = ", ".join(f"{name} {made[name]}" for name in ("ltv_mpc", "python", "numpy", "osqp", "numba") if name in made)
    lines.append(f"mode {info.mode}, seed {info.seed}, {info.duration_s:.1f} s{'; ' if by else ''}{by}")
    lines += [_segment(segment) for segment in info.segments]
    lines.append(f"{info.messages} messages, {info.missing or 'none'} missing{_unreadable(info)}")
    lines += ["", *_columns([_HEAD, *(_row(key) for key in info.keys)])]
    if gaps := [line for key in info.keys for line in _gaps(key)]:
        lines += ["", "gaps", *gaps]
    if info.events:
        shown = info.events[:MAX_EVENTS]
        lines += ["", f"events ({info.events_total})"]
        lines += [f"  {event.t_s:9.2f} s  {event.node}: {event.kind}: {event.text}" for event in shown]
        if info.events_total > len(shown):
            lines.append(f"  ... {info.events_total - len(shown)} more")
    if not info.whole:
        lines += ["", "not whole: `ltv-mpc log recover RUN` writes what is there into one that is"]
    return "\n".join(lines)


def recovered(made: Recovery) -> str:
    """What was saved and what was lost."""
    lines = []
    for part in made.segments:
        state = "whole" if part.whole else f"{part.lost_bytes} bytes lost"
        lines.append(f"{part.file}: {part.messages} messages saved, {state} of {part.size_bytes}")
        lines += [f"  byte {loss.offset}: {loss.length} bytes: {loss.why}" for loss in part.losses]
        if part.orphans:
            lines.append(f"  {part.orphans} messages left out: their channel is named in a lost part")
    lines.append(f"{made.messages} messages saved, {made.lost_bytes} bytes lost")
    return "\n".join(lines)


def exported(result: ExportResult | TraceSummary) -> str:
    """What the files hold."""
    if isinstance(result, TraceSummary):
        parts = f"{result.slices} slices of {result.processes} processes, {result.arrows} arrows, {result.marks} marks"
        lines = [f"{result.file}: {parts}; open it at https://ui.perfetto.dev"]
    else:
        rows = [(file.file, str(file.rows), str(file.columns)) for file in result.files]
        lines = _columns([("file", "rows", "columns"), *rows])
    if result.unreadable:
        lines.append(f"{result.unreadable} messages left out: not what their key holds")
    return "\n".join(lines)


_HEAD = ("key", "messages", "rate/s", "first s", "last s", "kB", "missing", "starts")


def _row(key: Key) -> tuple[str, ...]:
    rate = "-" if key.rate_hz is None else f"{key.rate_hz:.4g}"
    size = f"{key.bytes / 1e3:.1f}"
    times = f"{key.first_s:.2f}", f"{key.last_s:.2f}"
    return (key.key, str(key.messages), rate, *times, size, str(key.missing or "-"), str(len(key.sources)))


def _segment(segment: Segment) -> str:
    times = "" if segment.first_s is None else f", {segment.first_s:.1f} to {segment.last_s:.1f} s"
    state = "whole" if segment.whole else f"NOT WHOLE, {segment.lost_bytes} bytes give nothing"
    return f"{segment.file}: {segment.bytes / 1e6:.2f} MB, {segment.messages} messages{times}, {state}"


def _unreadable(info: Info) -> str:
    return f", {info.unreadable} without a header" if info.unreadable else ""


def _gaps(key: Key) -> Iterable[str]:
    for source in key.sources:
        words = [f"{source.missing} of {source.published}"] if source.missing else []
        if source.missing:
            listed = ", ".join(f"{a}" if a == b else f"{a} to {b}" for a, b in source.gaps)
            words.append(f"sequence {listed}")
        if source.doubled:
            words.append(f"{source.doubled} there twice")
        if words:
            yield f"  {key.key}, epoch {source.epoch}: {'; '.join(words)}"


def _columns(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Texts to the left, numbers to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join(
            f"{cell:<{width}}" if i == 0 else f"{cell:>{width}}"
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
