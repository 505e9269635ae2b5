"""Notifications to the service manager, on a socket of the test."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.bus.options import BusOptions
from services.bus.session import open_session
from services.runtime.service_manager import ServiceManager
from services.runtime.stopping import StopRequest
from services.supervisor import loopback

PATIENCE_S = 240.0


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    """Socket that receives notifications, and its address as systemd gives it."""
    name = str(tmp_path / "notify") if request.param == "path" else f"@ltv-mpc-{os.getpid()}-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(name.replace("@", "\0", 1))
        receiver.setblocking(False)
        yield receiver, name


def received(receiver: socket.socket) -> list[str]:
    texts = []
    while True:
        try:
            texts.append(receiver.recv(4096).decode())
        except BlockingIOError:
            return texts


def test_the_manager_is_told_ready_status_stopping_and_four_times_in_its_time_out_that_the_loop_runs(
    manager: tuple[socket.socket, str],
) -> None:
    receiver, address = manager
    process = ServiceManager()
    process.connect({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())})
    process.beat(0)  # not before it is ready
    for text in ("waiting\nfor the router", "waiting for the router"):
        process.status(text)
    process.ready()
    assert received(receiver) == ["STATUS=waiting for the router", "READY=1"]
    sent = []
    for now_us in range(0, 10_000_000, 50_000):
        process.beat(now_us)
        sent += received(receiver)
    assert sent == 20 * ["WATCHDOG=1"]
    process.stopping()
    process.status("gone")
    assert received(receiver) == ["STOPPING=1"]
    assert process.due_us is None


@pytest.mark.parametrize("manager", ["path"], indirect=True)
@pytest.mark.parametrize("watchdog", [{}, {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "soon"}])
def test_without_a_watchdog_of_this_process_none_is_notified(
    watchdog: dict[str, str], manager: tuple[socket.socket, str]
) -> None:
    receiver, address = manager
    process = ServiceManager()
    process.connect({"NOTIFY_SOCKET": address, **watchdog})
    process.ready()
    process.beat(10**9)
    assert process.due_us is None
    assert received(receiver) == ["READY=1"]
    process.stopping()


@pytest.mark.parametrize("address", ["", "vsock:2:1234", "/nonexistent/notify"])
def test_without_a_manager_nothing_is_sent_and_nothing_fails(address: str) -> None:
    process = ServiceManager()
    process.connect({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000"})
    process.ready()
    process.status("running")
    process.beat(1)
    process.stopping()


@pytest.mark.parametrize("manager", ["path"], indirect=True)
def test_a_manager_that_does_not_read_blocks_no_process(manager: tuple[socket.socket, str]) -> None:
    receiver, address = manager
    process = ServiceManager()
    process.connect({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "4000"})
    process.ready()
    for now_us in range(0, 2_000_000, 1000):
        process.beat(now_us)
    assert 0 < len(received(receiver)) < 2000
    process.stopping()


@pytest.mark.timeout(300)
@pytest.mark.parametrize("manager", ["path"], indirect=True)
def test_an_estimator_reports_ready_and_notifies_the_watchdog(manager: tuple[socket.socket, str]) -> None:
    """Its unit has ``Type=notify`` and a watchdog: without these systemd would end it at its start."""
    receiver, address = manager
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    line = [sys.executable, "-P", "-m", "services.cli", "estimator", "--connect", endpoint]
    environment = os.environ | {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "5000000"}
    with (
        open_session(BusOptions(listen=(endpoint,)), stop=StopRequest(), say=print),
        subprocess.Popen(line, env=environment) as estimator,
    ):
        try:
            receiver.settimeout(PATIENCE_S)
            texts, until = [], time.monotonic() + PATIENCE_S
            while "WATCHDOG=1" not in texts:
                assert time.monotonic() < until
                texts.append(receiver.recv(4096).decode())
        finally:
            estimator.terminate()
    assert [text for text in texts if not text.startswith("STATUS")] == ["READY=1", "WATCHDOG=1"]
