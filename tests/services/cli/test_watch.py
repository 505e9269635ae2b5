"""``ltv-mpc watch``: what a bus carries, as lines in a pipe."""

from __future__ import annotations

import io
import threading
from unittest.mock import Mock

import pytest
from msgspec.structs import replace

from ltv_mpc.messages import Estimate, NodeStatus
from services.bus.options import BusOptions
from services.bus.outbox import Outbox
from services.bus.session import open_session
from services.cli.app import run
from services.reporting import terminal
from services.runtime.stopping import StopRequest
from services.supervisor.bus_monitor import Activity, BusMonitor
from services.tools import watch
from tests.services.words import status
from tests.waiting import until


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
    ("options", "says"),
    [
        ((), ("no message yet", "add --namespace fleet/boat")),
        (("--namespace", "fleet/boat"), ("t 81.3 s  ", "depth 7.25 m")),
    ],
    ids=["another namespace is named", "a vehicle without clock is shown by its estimates"],
)
def test_it_shows_what_a_bus_carries(options, says, free_port, monkeypatch, capsys) -> None:
    endpoint, request, shown = f"tcp/127.0.0.1:{free_port}", StopRequest(), io.StringIO()
    monkeypatch.setattr(watch, "run_until_stopped", lambda console, work: work(request, console.say))
    monkeypatch.setattr(terminal, "LINE_S", 0.0)  # in a pipe
    estimate = replace(Estimate.at_rest(depth_m=7.25), t_ns=81_300_000_000)
    watching = threading.Thread(target=run, args=(["watch", "--connect", endpoint, *options],))
    listening = BusOptions(listen=(endpoint,), namespace="fleet/boat")
    with open_session(listening, stop=StopRequest(), say=print) as session:
        outbox = Outbox(session, node="estimator", epoch=1, kinds=(NodeStatus, Estimate))

        def says_all() -> bool:
            for message in (status("estimator"), estimate):
                outbox.publish(message)
            shown.write(capsys.readouterr().err)
            return all(text in shown.getvalue() for text in says)

        watching.start()
        try:
            until(says_all)
        finally:
            request.request()
            watching.join()
