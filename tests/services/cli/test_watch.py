"""``ltv-mpc watch``: what a bus carries, as lines in a pipe."""

from __future__ import annotations

import subprocess
import sys
import time
from unittest.mock import Mock

import msgspec

from ltv_mpc.messages import Estimate, NodeStatus
from services.bus.options import BusOptions
from services.bus.outbox import Outbox
from services.bus.session import open_session
from services.runtime.stopping import StopRequest
from services.supervisor import loopback
from services.supervisor.bus_monitor import Activity, BusMonitor
from services.tools import watch
from tests.services.words import status

PATIENCE_S = 60.0


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


def test_processes_in_another_namespace_are_named() -> None:
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    listening = BusOptions(listen=(endpoint,), namespace="fleet/boat")
    line = [sys.executable, "-P", "-m", "services.cli", "watch", "--connect", endpoint]
    with open_session(listening, stop=StopRequest(), say=print) as session:
        statuses = Outbox(session, node="estimator", epoch=1, kinds=(NodeStatus,))
        with subprocess.Popen(line, stderr=subprocess.PIPE, text=True) as watching:
            assert watching.stderr is not None
            until = time.monotonic() + PATIENCE_S
            try:
                assert "no message yet" in watching.stderr.readline()  # it listens
                text = ""
                while "add --namespace fleet/boat" not in text:
                    assert time.monotonic() < until
                    statuses.publish(status("estimator"))
                    text = watching.stderr.readline()
            finally:
                watching.terminate()


def test_a_vehicle_without_clock_is_shown_by_its_estimates() -> None:
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    listening = BusOptions(listen=(endpoint,), namespace="boat")
    line = [sys.executable, "-P", "-m", "services.cli", "watch", "--connect", endpoint, "--namespace", "boat"]
    with open_session(listening, stop=StopRequest(), say=print) as session:
        estimates = Outbox(session, node="estimator", epoch=1, kinds=(Estimate,))
        with subprocess.Popen(line, stderr=subprocess.PIPE, text=True) as watching:
            assert watching.stderr is not None
            until = time.monotonic() + PATIENCE_S
            text = ""
            try:
                while "depth 7.2 m" not in text:
                    assert time.monotonic() < until
                    estimates.publish(msgspec.structs.replace(Estimate.at_rest(depth_m=7.25), t_ns=81_300_000_000))
                    text = watching.stderr.readline()
                assert "t 81.3 s  " in text
            finally:
                watching.terminate()
