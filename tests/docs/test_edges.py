"""The example of docs/edges.md: built, fed, and run in a loop beside a bus."""

from __future__ import annotations

import importlib.util
import json
import math
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ltv_mpc.messages import Estimate, NodeStatus
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.session import open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import Header, decode, encode
from services.edges.edge import Received
from services.processes.edge_loop import EdgeLoop
from services.runtime.stopping import StopRequest
from services.supervisor import loopback
from tests.docs.changed_tree import build, run
from tests.services.edges.plans import SECOND_NS, plan

PAGE = "docs/edges.md"
NAME = "json_lines"


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Build the files of the page; yield the names in its edge and its process."""
    folder, found, added = tmp_path_factory.mktemp("edge"), {}, []
    build(PAGE, folder)
    for package in ("services.edges", "services.processes"):
        name = f"{package}.{NAME}"
        spec = importlib.util.spec_from_file_location(name, folder / f"{name.replace('.', '/')}.py")
        assert spec is not None
        assert spec.loader is not None
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        added.append(name)
        spec.loader.exec_module(module)
        found |= vars(module)
    yield found
    for name in added:
        del sys.modules[name]


def line(**fields: Any) -> bytes:
    state = {"t_ms": 7000, "heading_deg": 90.0, "north": 3.0, "east": 4.0, "speed": 2.0}
    return json.dumps(state | fields).encode()


def test_the_example_converts_both_ways_and_counts_what_it_refuses(names: dict[str, Any]) -> None:
    edge = names["JsonEdge"](epoch=1)
    (estimate,) = edge.receive(Received("", line(), b"", 1_000))
    assert (estimate.north_m, estimate.east_m, estimate.t_ns) == (3.0, 4.0, 7 * SECOND_NS)
    assert (estimate.velocity_north_mps, estimate.velocity_east_mps) == pytest.approx((0.0, 2.0), abs=1e-12)
    for broken in (b"", b"[]", line(north="x"), line(north=math.nan), line(t_ms=math.inf), b"[" * 100_000):
        assert edge.receive(Received("", broken, b"", 2_000)) == []
    assert (edge.accepted, edge.refused) == (1, 6)
    assert list(edge.step(501_000)) == []
    list(edge.take(plan(7 * SECOND_NS), 1_000))
    (frame,) = edge.step(501_000)
    assert json.loads(frame.payload) == {"port": 5.0, "starboard": -10.0}
    (frame,) = edge.step(2_101_000)
    assert json.loads(frame.payload) == {"port": 0.0, "starboard": 0.0}


def test_the_example_runs_as_a_process_does(names: dict[str, Any]) -> None:
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    vehicle.bind(("127.0.0.1", 0))
    vehicle.settimeout(30.0)
    stop = StopRequest()
    with (
        open_session(BusOptions(listen=(endpoint,)), stop=stop, say=print) as router,
        open_session(BusOptions(connect=(endpoint,)), stop=stop, say=print) as session,
    ):
        estimates, statuses, mailbox = Mailbox(), Mailbox(), Mailbox()
        router.subscribe("estimate", BY_TYPE[Estimate], estimates)
        router.subscribe("status/json", BY_TYPE[NodeStatus], statuses)
        link = names["UdpLink"](vehicle.getsockname(), mailbox)
        loop = EdgeLoop(names["JsonEdge"](epoch=1), session, mailbox, 1, print)
        stop.on_request(mailbox.wake)
        thread = threading.Thread(target=loop.run, args=(link, 50_000, stop))
        thread.start()
        try:
            put_plan = router.publisher("plan").put
            until, number, estimate = time.monotonic() + 60.0, 0, None
            while estimate is None:
                assert time.monotonic() < until
                vehicle.sendto(line(t_ms=time.monotonic_ns() / 1e6), link.socket.getsockname())
                estimate = estimates.take(0.1)
            assert decode(Estimate, estimate.payload)[0].north_m == 3.0
            thrust: dict[str, float] = {}
            while thrust.get("port") != 10.0:
                assert time.monotonic() < until
                put_plan(
                    encode(plan(time.monotonic_ns() - SECOND_NS), Header(epoch=2, sequence=number, sent_monotonic_us=0))
                )
                vehicle.sendto(line(t_ms=time.monotonic_ns() / 1e6), link.socket.getsockname())
                number += 1
                thrust = json.loads(vehicle.recv(4096))
        finally:
            stop.request()
            thread.join(30.0)
        vehicle.settimeout(0.5)
        last = b""
        try:
            while True:
                last = vehicle.recv(4096)
        except TimeoutError:
            pass
        assert json.loads(last) == {"port": 0.0, "starboard": 0.0}
        found = []
        while (frame := statuses.take(0.5)) is not None:
            found.append(decode(NodeStatus, frame.payload)[0])
        assert found[-1].finished
        assert found[-1].steps >= 1
        vehicle.close()


TARGET = """
import random
from tests.fuzz.targets import all_targets
(target,) = (target for target in all_targets() if target.name == "json lines")
accepted = 0
for seed in range(500):
    found = target.take(target.frame(random.Random(seed)))
    if found is not None:
        target.check(found)
        accepted += 1
assert 0 < accepted < 500
"""

COMMAND = """
from services.cli.app import run
run(["json-lines", "--help"])
assert run(["json-lines", "--connect", "nowhere"]) == 2
"""


def test_damaged_frames_of_the_example_are_counted_by_its_target(tmp_path: Path) -> None:
    build(PAGE, tmp_path)
    run(TARGET, tmp_path)


def test_the_command_of_the_example_has_the_options_of_the_bus(tmp_path: Path) -> None:
    build(PAGE, tmp_path)
    assert "--certs" in run(COMMAND, tmp_path)
