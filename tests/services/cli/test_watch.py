"""``ltv-mpc watch``: what a bus carries, as lines in a pipe."""

from __future__ import annotations

from unittest.mock import Mock

import pytest
from msgspec.structs import replace

from ltv_mpc.messages import Estimate, NodeStatus
from services.bus.options import BusOptions
from services.bus.outbox import Outbox
from services.bus.session import open_session
from services.runtime.stopping import StopRequest
from services.supervisor import loopback
from services.supervisor.bus_monitor import Activity, BusMonitor
from services.tools import watch
from tests.services.words import status
from tests.system.alone import CLI, started


def test_a_process_that_no_longer_publishes_is_named_silent() -> None:
    newest, last = status("estimator"), Activity(epoch=1, arrived_s=100.0)
    monitor = Mock(BusMonitor, newest=Mock(return_value=newest), last_activity=Mock(return_value=last))
    assert watch.state_of(monitor, "estimator", 102.0) == "running"
    assert watch.state_of(monitor, "estimator", 160.0) == "silent for 60 s"
    monitor.newest.return_value = status("estimator", finished=True)
    assert watch.state_of(monitor, "estimator", 160.0) == "finished"


def test_silence_has_its_duration_and_no_message_is_no_silence() -> None:
    monitor = Mock(BusMonitor, last_activity=Mock(return_value=Activity(epoch=0, arrived_s=100.0)))
    assert watch.silence(monitor, 102.0) == ""
    assert watch.silence(monitor, 160.0) == "no message for 60 s"
    monitor.last_activity.return_value = Activity(epoch=0, arrived_s=0.0)
    assert watch.silence(monitor, 160.0) == "no message yet"


@pytest.mark.parametrize(
    ("options", "said"),
    [((), "add --namespace fleet/boat"), (("--namespace", "fleet/boat"), "t 81.3 s  ")],
    ids=["another namespace is named", "a vehicle without clock is shown by its estimates"],
)
def test_it_shows_what_a_bus_carries(options: tuple[str, ...], said: str) -> None:
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    listening = BusOptions(listen=(endpoint,), namespace="fleet/boat")
    estimate = replace(Estimate.at_rest(depth_m=7.25), t_ns=81_300_000_000)
    with (
        open_session(listening, stop=StopRequest(), say=print) as session,
        started(*CLI, "watch", "--connect", endpoint, *options) as (_, watching),
    ):
        outbox = Outbox(session, node="estimator", epoch=1, kinds=(NodeStatus, Estimate))
        watching.until(lambda line: "no message yet" in line)  # it listens

        def is_said(line: str) -> bool:
            for message in (status("estimator"), estimate):
                outbox.publish(message)
            return said in line

        shown = watching.until(is_said)
    assert "depth 7.25 m" in shown or not options
