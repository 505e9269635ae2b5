"""Restart of the controller of the foreign craft, as processes of their own."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from services.supervisor import loopback
from tests.foreign_plant.flight import HERE, HULL
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
