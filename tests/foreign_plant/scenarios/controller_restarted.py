"""Restart of the controller alone: killed, and another process continues from the checkpoint after 3 s.

The actuators reject the plans of another controller while those of the first one are in time, by the protocol's rule.
"""

from __future__ import annotations

import io
import tempfile
from pathlib import Path
from typing import Any

from ltv_mpc.config import to_toml
from ltv_mpc.references import Reference
from services.processes.checkpoint import Checkpoint
from services.runtime.console import Console
from tests.foreign_plant.flight import ORIGIN, SQUARE, Figure, Flight, distance_m
from tests.foreign_plant.scenarios.square import distance_from_outline_m

DEAD_S = 3.0
SILENT_US = 750_000
"""Silence of one controller after which the actuators accept another one: 2.5 periods."""


class RestartedFlight(Flight):
    """Flight whose controller has a checkpoint, and whose actuators follow one controller at a time."""

    def __init__(
        self, folder: Path, *, reference: Reference = ORIGIN, reports: bool = True, resumes: bool = True
    ) -> None:
        super().__init__(reference, reports=reports)
        self._folder, self._resumes = folder, resumes
        self._commander, self._accepted_us = 0, -SILENT_US
        self.in_force_us: dict[int, int] = {}
        """Time of the first accepted plan of each controller, by its epoch."""
        self.start()

    def accepts(self, plan: dict[str, Any]) -> bool:
        epoch = plan["epoch"]
        if epoch != self._commander and self.host_us - self._accepted_us < SILENT_US:
            return False
        self._commander, self._accepted_us = epoch, self.host_us
        self.in_force_us.setdefault(epoch, self.host_us)
        return True

    def start(self) -> None:
        """Start a controller from the checkpoint."""
        within_s = 60.0 if self._resumes else None
        console = Console("controller", out=io.StringIO())
        self.checkpoint = Checkpoint(self._folder, to_toml(self.reference), resume_within_s=within_s, console=console)
        self.start_controller(self.checkpoint)

    def restart(self, dead_s: float = DEAD_S) -> float:
        """Kill the controller and start another one. Return the time (s) from the kill to its first plan in force."""
        killed_us = self.host_us
        self.kill_controller()
        self.checkpoint.close()
        self.fly(dead_s)
        self.start()
        while self.epoch not in self.in_force_us:
            self.fly(0.1)
        return (self.in_force_us[self.epoch] - killed_us) * 1e-6


def run() -> list[Figure]:
    """Return the drift from the point and from the outline of a square, and the time until a plan is in force."""
    figures = []
    for name, reports in (("actuators report", True), ("no reports", False)):
        flight, in_force_s = held(reports=reports)
        figures += [
            Figure(f"drift, {name}", float(distance_m(flight.track[1500:]).max()), 0.5, "m"),
            Figure(f"kill to plan in force, {name}", in_force_s, 5.0, "s"),
            Figure(f"plans rejected, {name}", flight.actuators.rejected, 0, ""),
        ]
    return [*figures, Figure("distance from the outline of a square", _off_the_square_m(), 0.5, "m")]


def held(*, reports: bool = True, resumes: bool = True) -> tuple[Flight, float]:
    """Return a flight of 30 s, a restart and 30 s, and the time from the kill to the next plan in force (s)."""
    with tempfile.TemporaryDirectory() as folder:
        flight = RestartedFlight(Path(folder), reports=reports, resumes=resumes)
        flight.command(action="arm")
        flight.fly(33.0)  # the newest state is some seconds old
        in_force_s = flight.restart()
        flight.fly(30.0)
        flight.checkpoint.close()
    return flight, in_force_s


def _off_the_square_m() -> float:
    """Return the largest distance from the outline when the controller is killed on the second side."""
    with tempfile.TemporaryDirectory() as folder:
        flight = RestartedFlight(Path(folder))
        flight.command(action="arm")
        flight.fly(30.0)
        flight.command(action="follow", reference_toml=SQUARE.read_text())
        flight.fly(40.0)
        flight.restart()
        track = flight.fly(40.0)
        flight.checkpoint.close()
    return float(distance_from_outline_m(track).max())
