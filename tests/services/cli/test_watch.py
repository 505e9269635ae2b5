"""``ltv-mpc watch``: what a bus carries, as lines in a pipe."""

from __future__ import annotations

import subprocess
import sys
import time

import msgspec

from ltv_mpc.messages import Estimate
from services.bus.options import BusOptions
from services.bus.outbox import Outbox
from services.bus.session import open_session
from services.runtime.stopping import StopRequest
from services.supervisor import loopback

PATIENCE_S = 60.0


def test_a_vehicle_without_clock_is_shown_by_its_estimates() -> None:
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    listening = BusOptions(listen=(endpoint,), namespace="boat")
    line = [sys.executable, "-P", "-m", "services.cli", "watch", "--connect", endpoint, "--namespace", "boat"]
    with open_session(listening, stop=StopRequest(), say=print) as session:
        estimates = Outbox(session, node="estimator", epoch=1, kinds=(Estimate,))
        with subprocess.Popen(line, stderr=subprocess.PIPE, text=True) as watch:
            assert watch.stderr is not None
            until = time.monotonic() + PATIENCE_S
            text = ""
            try:
                while "depth 7.2 m" not in text:
                    assert time.monotonic() < until
                    estimates.publish(msgspec.structs.replace(Estimate.at_rest(depth_m=7.25), t_ns=81_300_000_000))
                    text = watch.stderr.readline()
                assert "t 81.3 s  " in text
            finally:
                watch.terminate()
