"""The foreign craft as a process of its own: its clock is set back, its controller killed, and stopped by command."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from services.supervisor import loopback
from tests.foreign_plant.flight import HERE, HULL
from tests.foreign_plant.plant import SET_AT_S
from tests.foreign_plant.scenarios.controller_restarted import RestartedFlight, held
from tests.system.alone import CLI, Lines, started
from tests.waiting import until


@pytest.fixture
def notified(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], set[str]]]:
    """Return a function that returns what was sent to the service manager since the last call, without texts."""
    address = str(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        manager.setblocking(False)

        def read() -> set[str]:
            found = set()
            while True:
                try:
                    found.add(manager.recv(4096).decode().removesuffix("=1").partition("=")[0])
                except BlockingIOError:
                    return found

        yield read


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
def test_its_clock_is_set_back_and_a_killed_controller_continues_but_never_after_a_stop(
    tmp_path: Path, notified: Callable[[], set[str]]
) -> None:
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
        assert notified() >= {"READY", "WATCHDOG", "STATUS"}
        console.until(lambda line: "was set by -" in line)
        hold.until(lambda line: line["t_s"] > SET_AT_S + 2.0 and line["off_m"] < 0.3)
        assert hold.newest["authority"] == "controller"

        def restart() -> None:
            """Kill the controller, start it again and wait until its first plan is in force."""
            nonlocal process
            epoch = hold.newest["epoch"]
            process.kill()
            process, _ = stack.enter_context(started(*controller))
            hold.until(lambda line: line["epoch"] != epoch)

        restart()
        assert hold.newest["authority"] == "controller"
        hold.until(lambda line: line["off_m"] < 0.3)
        watchdog_stops_with_the_process(process, notified)
        answer = subprocess.run([*CLI, "ctl", "stop", *connected], capture_output=True, text=True, check=False)
        restart()
        assert "stopped" in answer.stdout, answer.stderr
        assert hold.newest["authority"] == "stopped"
        notified()  # a socket holds ten notifications, and the next one must find room
        process.terminate()
        process.wait(60.0)
        assert "STOPPING" in notified()


def watchdog_stops_with_the_process(process: subprocess.Popen[str], notified: Callable[[], set[str]]) -> None:
    """Stop the process for longer than the time-out of its watchdog, and let it continue."""
    os.kill(process.pid, signal.SIGSTOP)
    notified()  # what was sent before
    time.sleep(2.5)  # there is no event to wait for: nothing may come
    assert notified() == set()
    os.kill(process.pid, signal.SIGCONT)
    until(lambda: "WATCHDOG" in notified())


def test_without_resume_armed_it_drifts_until_arm_continues_the_reference(tmp_path: Path) -> None:
    flight = RestartedFlight(tmp_path, resumes=False)
    flight.command(action="arm")
    flight.fly(20.0)
    flight.restart()
    flight.fly(3.0)
    assert flight.plans[-1].authority == "disarmed"
    flight.command(action="arm")
    flight.fly(1.0)
    assert flight.plans[-1].authority == "controller"


def test_the_learned_current_is_not_learned_again() -> None:
    """Without it the craft would be half a metre off once more: see the start of the hold."""
    flight, _ = held()
    first = next(plan for plan in flight.plans if plan.cycle_t_ns > flight.plans[0].cycle_t_ns + 34_000_000_000)
    before = flight.plans[flight.plans.index(first) - 1]
    assert abs(first.thrust_N[:, :2].mean() - before.thrust_N[:, :2].mean()) < 5.0
