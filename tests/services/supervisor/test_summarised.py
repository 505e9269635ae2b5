"""Summary at the end of a run: a signal skips it, and what is no recording does not end it with a traceback."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from services.run import folder
from services.run.run_config import resolve
from services.run.summary import STOPPED
from services.runtime.stopping import StopRequest
from services.supervisor import supervisor
from services.supervisor.supervisor import Outcome, Supervisor
from tests.services.edges.plans import plan
from tests.services.recording.recordings import write, write_depths


class Screen:
    """Screen on which the user presses Ctrl-C as soon as it shows a progress."""

    def __init__(self, request: StopRequest) -> None:
        self._request = request

    def wait(self, what: str, share: float) -> None:
        assert what == "summary"
        assert share < 1.0
        self._request.receive(signal.SIGINT, None)

    def say(self, text: str) -> None:
        pass


def ended(path: Path) -> tuple[Supervisor, Any]:
    """Return the supervisor of a run that a first Ctrl-C has ended."""
    run_config, request = resolve("hover"), StopRequest()
    request.receive(signal.SIGINT, None)
    screen: Any = Screen(request)
    made: Any = Supervisor(run_config, folder.make("x", run_config.files, out=path), screen)
    made._request, made._signals_at_stop, made.processes = request, request.signals, SimpleNamespace(restarts_s=[])
    return made, Outcome(exit_code=130, why=STOPPED)


@pytest.mark.parametrize("while_stopping", [None, signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_second_signal_skips_the_summary(tmp_path, monkeypatch, while_stopping) -> None:
    """It comes while the processes stop, or the summary is made. A terminal that closes hangs up twice: no skip."""
    monkeypatch.setattr(supervisor, "QUICK_S", -1.0 if while_stopping is None else 600.0)
    made, outcome = ended(tmp_path / "run")
    if while_stopping is not None:
        made._request.receive(while_stopping, None)
    write_depths(tmp_path / "run" / "run.mcap", range(2000))
    outcome = made._summarised(outcome)
    skipped = while_stopping is not signal.SIGHUP
    assert (outcome.summary is None) is skipped
    assert (outcome.exit_code, outcome.why) == (1 if while_stopping is signal.SIGTERM else 130, STOPPED)
    assert (tmp_path / "run" / "summary.json").exists() is not skipped


def test_a_fifo_in_place_of_the_recording_is_not_waited_for(tmp_path: Path) -> None:
    made, _ = ended(tmp_path / "run")
    os.mkfifo(tmp_path / "run" / "run.mcap")
    outcome = made._summarised(Outcome())
    assert outcome.exit_code == 1
    assert outcome.why.endswith("run.mcap: is not a regular file")


def test_results_that_cannot_be_written_leave_the_verdict_exit_1_and_no_draft(tmp_path: Path) -> None:
    """A folder takes the place of the file."""
    path = tmp_path / "run"
    made, _ = ended(path)
    write(path / "run.mcap", [("controller", plan(0), 1, 0, 0)])
    (path / "summary.json").mkdir()
    outcome = made._summarised(Outcome())
    assert outcome.exit_code == 1
    assert outcome.why == f"{path}: the results cannot be written: Is a directory"
    assert outcome.summary is not None
    assert not list(path.rglob("*.part"))
