"""The recorder process: every message of the run into run.mcap, or the next segment of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from services.bus.session import BusError, BusOptions, Stopped
from services.process.recording import NAME, RecordingLoop
from services.process.stopping import FAILED, sayer, stop_on_signals
from services.process.supervised import SUPERVISED
from services.recording.segments import SegmentWriter


def main(folder: Path, bus: BusOptions, *, start_ns: int, metadata: Mapping[str, str]) -> int:
    """Record into ``folder`` until told to stop. ``start_ns`` is where the run's time begins, log time 0."""
    say = sayer(NAME)
    with stop_on_signals() as request:
        try:
            SUPERVISED.state()
            with SegmentWriter(folder / "run.mcap", start_ns=start_ns, metadata=metadata) as writer:
                RecordingLoop(writer, start_ns=start_ns, stop=request, say=say).serve(bus)
        except Stopped:
            pass
        except (BusError, OSError) as error:
            say(str(error))
            return FAILED
        return request.exit_code
