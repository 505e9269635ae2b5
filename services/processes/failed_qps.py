"""QPs that were not solved, kept as files for ``ltv-mpc qp show``."""

from __future__ import annotations

from pathlib import Path

from ltv_mpc.control.controller import Controller
from ltv_mpc.control.qp.failed_qp import FailedQp
from ltv_mpc.messages import ControllerStatus
from services.runtime.stopping import Say

MOST = 20
"""Files of one run: what fails once a second says nothing new after that."""


class FailedQps:
    """Looks at most once a second, beside the cycles, at what the controller could not solve last."""

    def __init__(self, controller: Controller, folder: Path, say: Say) -> None:
        self._controller, self._folder, self._say = controller, folder, say
        self._seen: FailedQp | None = None
        self.kept = 0

    def show(self, status: ControllerStatus, _now_us: int) -> None:
        """Keep it if it is another one."""
        failed = self._controller.failed
        if failed is None or failed is self._seen or self.kept >= MOST:
            return
        self._seen = failed
        path = self._folder / f"qp-{status.t_ns}.npz"
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            failed.save(path)
        except OSError as error:
            self._say(f"a QP was not solved and cannot be saved in {self._folder}: {error.strerror}")
            return
        self.kept += 1
        self._say(f"a QP was not solved ({failed.solve.why}); saved: ltv-mpc qp show {path}")
