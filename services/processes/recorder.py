"""Recorder process: writes every message of the run to run.mcap, or to its next segment."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec

from services.bus.options import BusOptions
from services.bus.session import BusError
from services.recording.segments import SegmentWriter
from services.runtime.console import Console
from services.runtime.recording_loop import NAME, RecordingLoop
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

MODE = "services"
"""Mode in the metadata of a recording of a simulation as processes."""


class Config(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration of the recorder process."""

    bus: BusOptions
    folder: Path  # of the run
    start_ns: int | None = None  # vehicle time of log time 0; None beside a vehicle, whose times are stored as they are
    metadata: dict[str, str]  # kept in the recording
    log_json: bool = False  # lines on stderr as JSON objects


def metadata(seed: int, files: Mapping[str, str]) -> dict[str, str]:
    """Return the metadata of a recording of a simulation: mode, seed, and the settings files by their path."""
    return {"mode": MODE, "seed": str(seed), **files}


def main(config: Config) -> int:
    """Record until a stop is requested."""

    def work(request: StopRequest, say: Say) -> None:
        recording = config.folder / "run.mcap"
        with SegmentWriter(recording, start_ns=config.start_ns or 0, metadata=config.metadata) as writer:
            RecordingLoop(writer, start_ns=config.start_ns, say=say).serve(config.bus, request)

    return run_until_stopped(Console(NAME, as_json=config.log_json), work, failures=(BusError, OSError))
