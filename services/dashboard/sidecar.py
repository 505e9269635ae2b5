"""Live page of a run started on this machine: a separate process, whose failure does not affect the run."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from pathlib import Path

import msgspec

from services.bus.options import BusOptions
from services.bus.topics import OPERATOR
from services.dashboard.config import SERVER, Config, View, missing_package
from services.runtime.stopping import Say
from services.supervisor import entry_point
from services.supervisor.entry_point import write_config

STOP_S = 1.5
REPORT_S = 5.0
"""Longest wait for the browsers that take the report."""


class Sidecar:
    """Process of the live page. ``say`` receives its address when it is ready; ``waits``: the run may wait for it.

    Start it from the main thread: the process ends with the thread that started it.
    """

    def __init__(self, say: Say, logs: Path, config: Config, *, waits: bool) -> None:
        self._say, self._logs, self._config, self._waits = say, logs, config, waits
        self._view: str = View.CLOSED
        self._changed = threading.Condition()  # of the view
        self._shown = ""
        self._process: subprocess.Popen[str] | None = None

    def start(self, bus: BusOptions) -> None:
        """Start the page on this bus, or report that a package is missing."""
        if missing := missing_package():
            self._say(f"no live page: {missing}")
            return
        path = self._logs / "dashboard.json"
        write_config(path, msgspec.structs.replace(self._config, bus=msgspec.structs.replace(bus, role=OPERATOR)))
        with path.with_suffix(".log").open("wb") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", entry_point.__name__, str(os.getpid()), SERVER, str(path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,
            )
        threading.Thread(target=self._receive, args=(self._process,), name="page", daemon=True).start()

    def show(self, preparation: str) -> None:
        """Show what is being prepared."""
        if self._process is None or preparation == self._shown:
            return
        assert self._process.stdin is not None
        self._shown = preparation
        with contextlib.suppress(BrokenPipeError):  # the page has failed, which does not affect the run
            self._process.stdin.write(f"{preparation}\n")
            self._process.stdin.flush()

    @property
    def awaited(self) -> bool:
        """True while a browser has opened the page but not drawn it."""
        return self._waits and self._view == View.OPENED and self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int | None:
        """Process identifier of the page; None before its start."""
        return None if self._process is None else self._process.pid

    def give_report(self) -> None:
        """Wait until each browser that shows the page has the report, which has been written."""
        if self._waits:
            with self._changed:
                self._changed.wait_for(lambda: self._view != View.DRAWN, REPORT_S)

    def stop(self) -> None:
        """Stop the process; kill it after ``STOP_S``."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # the page has failed
            process.stdin.close()
        process.terminate()
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _receive(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        with process.stdout as output:
            url = output.readline().strip()
            if url:
                self._say(f"live page: {url}")
            for line in output:  # that of a browser is among it
                if (word := line.strip()) in tuple(View):
                    self._set_view(word)
        self._set_view(View.CLOSED)

    def _set_view(self, view: str) -> None:
        with self._changed:
            self._view = view
            self._changed.notify_all()
