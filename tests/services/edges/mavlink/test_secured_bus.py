"""Edge to MAVLink on a secured bus, with the certificate of its role."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("pymavlink", reason="not installed: pip install pymavlink (extra mavlink)")

from ltv_mpc.messages import Estimate
from services.bus import certificates
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.roles import ROLES
from services.bus.session import open_session
from services.bus.topics import BY_TYPE
from services.runtime.stopping import StopRequest
from services.supervisor import loopback
from tests.foreign_plant.mavlink_flight import ROOT
from tests.system.alone import CLI, started


@pytest.mark.timeout(120)
def test_the_edge_works_on_a_secured_bus(free_port: int, tmp_path: Path) -> None:
    certificates.make(tmp_path, ROLES, hosts=(), days=1)
    endpoint, udp = f"tls/127.0.0.1:{free_port}", loopback.free_port()
    bus = ("--certs", str(tmp_path))
    simulated = ROOT / "examples/python/simulated_autopilot.py"
    edge = (*CLI, "mavlink", "--autopilot", f"udpin:127.0.0.1:{udp}", "--connect", endpoint, *bus)
    estimates = Mailbox()
    options = BusOptions(connect=(endpoint,), certs=tmp_path, role="display")
    with started(*CLI, "router", "--listen", endpoint, *bus) as (_, router):
        router.until(lambda line: "ready at" in line)
        with (
            open_session(options, stop=StopRequest(), say=print) as display,
            started(*edge) as (_, said),
            started(sys.executable, "-P", str(simulated), f"udpout:127.0.0.1:{udp}"),
        ):
            display.subscribe("estimate", BY_TYPE[Estimate], estimates)
            said.until(lambda line: "listens at" in line)
            assert estimates.take(60.0) is not None
