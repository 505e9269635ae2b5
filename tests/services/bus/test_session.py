"""Errors of Zenoh in words: what could not be done, where, and what to do. Zenoh's threads."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import zenoh

from services.bus.options import BusOptions
from services.bus.session import (
    ROUTER_THREADS,
    RUNTIME,
    THREADS,
    BusError,
    configuration,
    open_session,
    waiting_for_router,
)
from services.runtime.stopping import StopRequest
from tests.waiting import until


def error_of(*listen: str) -> str:
    with pytest.raises(BusError) as failed:
        open_session(BusOptions(listen=listen), stop=StopRequest(), say=print)
    return str(failed.value)


def test_an_address_in_use_is_named(free_port: int) -> None:
    free = f"tcp/127.0.0.1:{free_port}"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        used = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        assert error_of(free, used) == (
            f"cannot listen at {used}: the address is in use: "
            "stop the process that listens there, or choose another port"
        )


@pytest.mark.parametrize(
    ("endpoint", "explanation"),
    [
        ("tcp/192.0.2.1:7000", "this machine has no such address: listen at one that `ip address` shows"),
        ("tcp/127.0.0.1:7000#iface=none0", "this machine has no such network interface"),
        ("tls/127.0.0.1:7000", "certificates are needed: --certs DIR; `ltv-mpc certs new DIR` makes them"),
        ("quic/127.0.0.1:7000", "certificates are needed"),
        ("unixsock-stream/{folder}/none/socket", "the folder does not exist: create it, or use another path"),
    ],
)
def test_what_zenoh_cannot_do_is_explained(endpoint: str, explanation: str, tmp_path: Path) -> None:
    endpoint = endpoint.format(folder=tmp_path)
    text = error_of(endpoint)
    assert text.startswith(f"cannot listen at {endpoint}: {explanation}")
    assert "Zenoh" not in text


@pytest.mark.parametrize(
    ("options", "command"),
    [
        (BusOptions(), "ltv-mpc router"),
        (BusOptions(connect=("tcp/10.0.0.7:7447",)), "ltv-mpc router --listen tcp/10.0.0.7:7447"),
        (BusOptions(certs=Path("certs")), "ltv-mpc router --certs DIR"),
    ],
)
def test_the_command_that_starts_the_router_listens_where_it_is_waited_for(options: BusOptions, command: str) -> None:
    assert f"; `{command}` starts one" in waiting_for_router(options)


@pytest.mark.skipif(sys.platform != "linux", reason="names of threads are read from /proc")
def test_all_tasks_of_zenoh_share_one_thread_and_those_of_a_router_three(free_port: int) -> None:
    """A wake-up of each further thread costs about as much as a message. In a process of its own: threads stay."""
    two_sessions = f"""
import time
from pathlib import Path
from services.bus.options import BusOptions
from services.bus.session import open_session
from services.runtime.stopping import StopRequest
from tests.waiting import until
with (
    open_session(BusOptions(listen=("tcp/127.0.0.1:{free_port}",)), stop=StopRequest(), say=lambda _: None),
    open_session(BusOptions(connect=("tcp/127.0.0.1:{free_port}",)), stop=StopRequest(), say=lambda _: None),
):
    names, ends = [], time.monotonic() + 10.0
    while sum(name.startswith("app-") for name in names) < 3 and time.monotonic() < ends:  # they start one by one
        names = [task.read_text() for task in Path("/proc/self/task").glob("*/comm")]
    print(*names, sep="")
"""
    environment = os.environ | {RUNTIME: THREADS}  # of a parent that is no router
    ended = subprocess.run(
        [sys.executable, "-c", two_sessions], env=environment, capture_output=True, text=True, timeout=60, check=True
    )
    names = ended.stdout.split()
    assert sum(name.startswith("app-") for name in names) >= 3  # of a router: closing a link may block one
    assert [name for name in names if name.startswith(("acc-", "net-", "rx-", "tx-"))] == []


@pytest.mark.parametrize(("inherited", "used"), [(THREADS, ROUTER_THREADS), ("()", "()")])
def test_a_router_has_its_own_threads_whatever_its_parent_had_but_not_what_a_user_has_set(
    inherited: str, used: str, free_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(RUNTIME, inherited)
    with open_session(BusOptions(listen=(f"tcp/127.0.0.1:{free_port}",)), stop=StopRequest(), say=print):
        assert os.environ[RUNTIME] == used


def test_what_may_not_be_dropped_waits_only_for_a_moment(free_port: int) -> None:
    """A burst fills the queue to its receiver; by default its sender then waits for 5 s."""
    endpoint = f"tcp/127.0.0.1:{free_port}"
    reached = configuration(BusOptions(connect=(endpoint,)))
    waited_s = []
    with (
        contextlib.suppress(zenoh.ZError),  # on a busy machine a link that is still full is not closed in time
        open_session(BusOptions(listen=(endpoint,)), stop=StopRequest(), say=print),
        zenoh.open(reached) as source,
        zenoh.open(reached) as receiver,
    ):
        receiver.declare_subscriber("burst", zenoh.handlers.Callback(lambda _: None, indirect=False))
        publisher = source.declare_publisher("burst", congestion_control=zenoh.CongestionControl.BLOCK)
        until(lambda: publisher.matching_status.matching)
        for _ in range(300):
            begin_s = time.monotonic()
            publisher.put(bytes(200_000))
            waited_s.append(time.monotonic() - begin_s)
    assert len(waited_s) == 300
    assert max(waited_s) < 3.0  # a busy machine only lengthens it
