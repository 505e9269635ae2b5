"""Recorder process: writes every message of the run to run.mcap, or to its next segment."""

from __future__ import annotations

from services.bus.session import BusError
from services.processes import settings
from services.recording.segments import SegmentWriter
from services.runtime.console import Console
from services.runtime.recording_loop import NAME, RecordingLoop
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

Config = settings.Recorder


def main(config: Config) -> int:
    """Record until a stop is requested."""

    def work(request: StopRequest, say: Say) -> None:
        recording = config.folder / "run.mcap"
        with SegmentWriter(recording, start_ns=config.start_ns or 0, metadata=config.metadata) as writer:
            RecordingLoop(writer, start_ns=config.start_ns, say=say).serve(config.bus, request)

    return run_until_stopped(Console(NAME, as_json=config.log_json), work, failures=(BusError, OSError))
