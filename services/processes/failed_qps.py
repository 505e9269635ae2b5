"""Failed QPs as files, for ``ltv-mpc qp show``."""

from __future__ import annotations

from pathlib import Path

from ltv_mpc.control.failed_qp import NamedQp
from ltv_mpc.control.solvers.recorder import QpRecorder
from ltv_mpc.messages import ControllerStatus
from services.runtime.stopping import Say

MAX_FILES = 20
"""Largest number of files of one run: a failure that repeats every second gives no more information."""


class FailedQps:
    """Writer of failed QPs: between the cycles, at most one file each time the status is published."""

    def __init__(self, recorder: QpRecorder, folder: Path, say: Say, *, max_files: int = MAX_FILES) -> None:
        """Write into ``folder`` what ``recorder`` keeps; ``say`` prints a line for a person."""
        self._recorder, self._folder, self._say, self._max_files = recorder, folder, say, max_files
        self._seen: NamedQp | None = None
        self.written = 0

    def show(self, status: ControllerStatus) -> None:
        """Write the last failed QP, if it was not written before."""
        failed = self._recorder.failed
        if failed is None or failed is self._seen or self.written >= self._max_files:
            return
        self._seen = failed
        path = self._folder / f"qp-{status.t_ns}.qp"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            failed.save(path)
        except OSError as error:
            self._say(f"a QP was not solved and cannot be saved in {self._folder}: {error.strerror}")
            return
        self.written += 1
        self._say(f"a QP was not solved ({failed.solve.why}); saved: ltv-mpc qp show {path}")
