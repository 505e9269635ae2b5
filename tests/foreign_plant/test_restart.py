"""Restarts of the controller of the foreign craft: in lock step, and as processes of their own.

In lock step the controller is killed, and another one continues from the checkpoint after 3 s. The actuators reject the
plans of another controller while those of the first one are in time, by the protocol's rule.
"""

from __future__ import annotations

import io
import json
import math
import sys
from collections.abc import Callable
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from ltv_mpc.config import to_toml
from services.processes.checkpoint import Checkpoint
from services.runtime.console import Console
from services.supervisor import loopback
from tests.foreign_plant.flight import HERE, HULL, Flight, farthest_m
from tests.foreign_plant.plant import SET_AT_S
from tests.system.alone import CLI, Lines, started


class Hold:
    """Lines of the plant, read until one is wanted."""

    def __init__(self, lines: Lines) -> None:
        self._lines = lines
        self.newest: dict[str, Any] = {}

    def until(self, wanted: Callable[[dict[str, Any]], bool], within_s: float = 120.0) -> None:
        """Read lines until one is ``wanted``."""
        self._lines.until(lambda line: line.startswith("{") and wanted(self._take(json.loads(line))), within_s)

    def _take(self, line: dict[str, Any]) -> dict[str, Any]:
        self.newest = line
        self.newest["off_m"] = math.hypot(line["north_m"], line["east_m"])
        return line


@pytest.mark.timeout(400)
def test_its_clock_is_set_back_and_a_killed_controller_continues(tmp_path: Path) -> None:
    """How far it drifts and when a plan is in force again: scenarios of a clock step and of a restart, in lock step."""
    (tmp_path / "point.toml").write_text('kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n')
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    connected = ("--connect", endpoint)
    hull_and_point = ("--vehicle", str(HULL), "--reference", str(tmp_path / "point.toml"))
    controller = (*CLI, "controller", *connected, *hull_and_point, "--state", str(tmp_path / "state"), "--resume-armed")
    with ExitStack() as stack:
        stack.enter_context(started(*CLI, "router", "--listen", endpoint))
        process, console = stack.enter_context(started(*controller))
        console.until(lambda line: "waiting for" in line)
        _, plant = stack.enter_context(started(sys.executable, "-P", str(HERE / "plant.py"), endpoint, "-5"))
        hold = Hold(plant)
        hold.until(lambda line: line["t_s"] > SET_AT_S - 1.0 and line["off_m"] < 0.3)
        console.until(lambda line: "was set by -" in line)
        hold.until(lambda line: line["t_s"] > SET_AT_S + 2.0 and line["off_m"] < 0.3)
        assert hold.newest["authority"] == "controller"

        epoch = hold.newest["epoch"]
        process.kill()
        stack.enter_context(started(*controller))
        hold.until(lambda line: line["epoch"] != epoch)  # the first plan of another process is in force
        assert hold.newest["authority"] == "controller"
        hold.until(lambda line: line["off_m"] < 0.3)


# --- in lock step ----------------------------------------------------------------------------------------------------

SILENT_US = 750_000
"""Silence of one controller after which the actuators accept another one: 2.5 periods."""


class RestartedFlight(Flight):
    """Flight whose controller has a checkpoint, and whose actuators follow one controller at a time."""

    def __init__(self, folder: Path) -> None:
        super().__init__(reports=False)
        self._folder = folder
        self._commander, self._accepted_us = 0, -SILENT_US
        self.in_force_us: dict[int, int] = {}
        """Time of the first accepted plan of each controller, by its epoch."""
        self.accepts = self._follows
        self.start()
        self.command(action="arm")

    def _follows(self, plan: dict[str, Any]) -> bool:
        epoch = plan["epoch"]
        if epoch != self._commander and self.host_us - self._accepted_us < SILENT_US:
            return False
        self._commander, self._accepted_us = epoch, self.host_us
        self.in_force_us.setdefault(epoch, self.host_us)
        return True

    def start(self) -> None:
        """Start a controller from the checkpoint."""
        console = Console("controller", out=io.StringIO())
        self.checkpoint = Checkpoint(self._folder, to_toml(self.reference), resume_within_s=60.0, console=console)
        self.start_controller(self.checkpoint)

    def restart(self) -> float:
        """Kill the controller and start another one. Return the time (s) from the kill to its first plan in force."""
        killed_us = self.host_us
        self.kill_controller()
        self.checkpoint.close()
        self.fly(3.0)
        self.start()
        while self.epoch not in self.in_force_us:
            self.fly(0.1)
        return (self.in_force_us[self.epoch] - killed_us) * 1e-6


def test_the_next_controller_continues_and_the_learned_current_is_not_learned_again(tmp_path: Path) -> None:
    """Without it the craft would be half a metre off once more: see the start of the hold. No thrust is reported."""
    flight = RestartedFlight(tmp_path)
    flight.fly(33.0)  # the newest state is some seconds old
    assert flight.restart() <= 5.0
    before, first = next(
        (a, b) for a, b in pairwise(flight.plans) if b.cycle_t_ns > flight.plans[0].cycle_t_ns + 34_000_000_000
    )
    assert abs(first.thrust_N[:, :2].mean() - before.thrust_N[:, :2].mean()) < 5.0
    flight.fly(30.0)
    assert farthest_m(flight.track[1500:]) < 0.5
    assert flight.actuators.rejected == 0
