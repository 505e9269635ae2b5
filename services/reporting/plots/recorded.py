"""Plot data of a recorded run, also from a recording that was cut off."""

from __future__ import annotations

from pathlib import Path

import msgspec

from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Applied, Estimate, Message, NodeSettings, NodeStatus, Truth
from services.bus.wire import Header
from services.recording.acceptance import Acceptance
from services.recording.history import Entry, Samples
from services.recording.node_settings import vehicle_of
from services.recording.reader import Recording, StoredMessage
from services.recording.recover import segments
from services.recording.writer import VEHICLE_MODE
from services.reporting.plots import analysis
from services.reporting.plots.collector import EVERY, NEWEST, ROWS, Collector
from services.reporting.plots.events import Mark
from services.reporting.plots.table import Columns
from services.reporting.safety import RunSafety

OFTEN: dict[type[Message], int] = {Truth: 200_000_000, Estimate: 200_000_000, Applied: 200_000_000}
"""Vehicle time (ns) between two decoded messages of these types; it grows with the length of the run."""
SHOWN: frozenset[type[Message]] = frozenset((*NEWEST, *EVERY, NodeStatus, NodeSettings))


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


def read(recording: Path, *, rows: int = ROWS) -> PlotData:
    """Read the plot data in one pass over the recording and its segments, decoding only the plotted messages.

    Only accepted messages are shown (``Acceptance``). Raises ``ConfigError`` if the file is not a recording.
    """
    parts = Recording(*segments(recording))
    shown: dict[tuple[type[Message], int], Samples] = {}  # by type and source: each source has rows of its own

    def passes(stored: StoredMessage, header: Header) -> bool:
        kind = stored.kind
        if kind is None or kind not in OFTEN:
            return True
        samples = shown.setdefault((kind, header.epoch), Samples(OFTEN[kind], rows))
        if due := samples.is_due(stored.t_ns):
            samples.add(Entry(stored.t_ns))
        return due

    files: dict[str, str] = {}  # of the processes that published their settings
    start_ns = 0
    safety = RunSafety()
    acceptance: Acceptance | None = None
    collector: Collector | None = None
    stored: StoredMessage | None = None
    for stored in parts:
        if stored.kind not in SHOWN:
            continue
        if collector is None or acceptance is None:
            start_ns = stored.t_ns if parts.metadata.get("mode") == VEHICLE_MODE else 0
            collector, acceptance = Collector(rows=rows, origin_ns=start_ns), Acceptance(vehicle_of(parts.metadata))
            collector.set_files(parts.metadata)
        for message, header, _ in acceptance.take(stored, SHOWN, passes):
            collector.add(message, header.epoch)
            safety.add(message, header.epoch)
            if isinstance(message, NodeSettings):
                files |= message.files
    if stored is None and not parts.cut:
        raise ConfigError(f"recording {recording}", "", "holds no message")
    metadata = {**files, **parts.metadata}
    collector = collector or Collector(rows=rows)
    collector.set_files(metadata)
    return PlotData(
        tables=analysis.tables(collector.all_tables()),
        values=collector.values,
        marks=tuple(collector.marks.marks),
        omitted_marks=collector.marks.omitted,
        start_s=start_ns / 1e9,
        safety=safety,
        cut=parts.cut,
        metadata=metadata,
    )
