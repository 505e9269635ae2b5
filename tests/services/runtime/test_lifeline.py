"""Notifications to a service manager and to a supervisor, on sockets of the test, and the state that is given."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.bus.options import BusOptions
from services.bus.session import open_session
from services.runtime.lifeline import GO, HEARTBEAT_PERIOD_US, Lifeline
from services.runtime.stage_timer import StageTimer
from services.runtime.stopping import StopRequest
from services.supervisor import loopback
from tests.system.alone import CLI, started
from tests.waiting import until


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


def test_the_manager_is_told_ready_status_stopping_and_four_times_in_its_time_out_that_the_loop_runs(manager) -> None:
    receiver, address = manager
    process = Lifeline()
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
def test_without_a_watchdog_of_this_process_none_is_notified(watchdog, manager) -> None:
    receiver, address = manager
    process = Lifeline()
    process.connect({"NOTIFY_SOCKET": address, **watchdog})
    process.ready()
    process.beat(10**9)
    assert process.due_us is None
    assert received(receiver) == ["READY=1"]
    process.stopping()


@pytest.mark.parametrize("address", ["", "vsock:2:1234", "/nonexistent/notify"])
def test_without_a_manager_nothing_is_sent_and_nothing_fails(address: str) -> None:
    process = Lifeline()
    process.connect({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000"})
    process.ready()
    process.status("running")
    process.beat(1)
    process.stopping()
    assert process.state == b""


@pytest.fixture
def supervisor() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Socket of the supervisor, and that of the process."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setblocking(False)
    with ours:
        yield ours, theirs


def supervised(ends: tuple[socket.socket, socket.socket], state: bytes = b"") -> Lifeline:
    """Return the lifeline of a process that the supervisor lets go on from this state."""
    process, stdin = Lifeline(), os.memfd_create("state")
    os.write(stdin, state)
    ends[0].send(GO)
    try:
        process.connect_to_supervisor(ends[1].detach(), stdin=stdin)
    finally:
        os.close(stdin)
    return process


def test_a_supervised_loop_sends_a_heartbeat_each_turn_up_to_the_expected_rate(supervisor, manager) -> None:
    """It has no other watchdog: the service manager watches the supervisor."""
    process = supervised(supervisor)
    process.connect({"NOTIFY_SOCKET": manager[1], "WATCHDOG_USEC": "1000"})
    for now_us in range(1_000_000, 1_000_001 + 2 * HEARTBEAT_PERIOD_US, 10_000):
        process.beat(now_us)
    assert received(supervisor[0]) == 3 * ["WATCHDOG=1"]
    StageTimer(process)("build")  # so does each stage of a cycle
    process.stopping()
    process.beat(10**15)
    assert received(supervisor[0]) == ["WATCHDOG=1", "STOPPING=1"]
    assert received(manager[0]) == []


@pytest.mark.parametrize("dead", [True, False])
def test_a_receiver_that_is_dead_or_does_not_read_blocks_no_process(supervisor, dead) -> None:
    process = supervised(supervisor)
    if dead:
        supervisor[0].close()
    for k in range(2000):
        process.beat(k * HEARTBEAT_PERIOD_US)
    assert dead or 0 < len(received(supervisor[0])) < 2000


@pytest.mark.parametrize("state", [bytes(2**21), b""])
def test_a_restarted_process_reads_its_restored_state(supervisor, state) -> None:
    assert supervised(supervisor, state).state == state


def test_a_process_whose_supervisor_is_dead_exits_before_it_starts(supervisor) -> None:
    supervisor[0].close()
    with pytest.raises(SystemExit):
        Lifeline().connect_to_supervisor(supervisor[1].detach())


@pytest.mark.timeout(300)
@pytest.mark.parametrize("manager", ["path"], indirect=True)
def test_an_estimator_reports_ready_and_notifies_the_watchdog(manager: tuple[socket.socket, str]) -> None:
    """Its unit has ``Type=notify`` and a watchdog: without these systemd would end it at its start."""
    receiver, address = manager
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    environment = ("env", f"NOTIFY_SOCKET={address}", "WATCHDOG_USEC=5000000")
    texts: list[str] = []
    with (
        open_session(BusOptions(listen=(endpoint,)), stop=StopRequest(), say=print),
        started(*environment, *CLI, "estimator", "--connect", endpoint),
    ):
        until(lambda: texts.extend(received(receiver)) or "WATCHDOG=1" in texts)
    assert [text for text in texts if not text.startswith("STATUS")] == ["READY=1", "WATCHDOG=1"]
