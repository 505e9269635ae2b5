"""Latency of messages, beside a bare Zenoh ping on the same router in the same run.

    .venv/bin/python -m benchmarks.latency [--messages N]

One-way times are differences of CLOCK_MONOTONIC, which all processes of a host share. A ping is 200 bytes there and
back between two processes. A command is answered by a cycle of its own: its round trip is that of an estimate that a
plan is built on at once.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import msgspec
import numpy as np

from ltv_mpc.messages import Acknowledgement, Action, Command, Estimate, Plan
from services.bus.mailbox import Frame, Mailbox
from services.bus.options import BusOptions
from services.bus.outbox import Outbox
from services.bus.session import open_session
from services.bus.wire import decode
from services.supervisor import loopback

CLI = (sys.executable, "-P", "-m", "services.cli")
ECHO = """
import json, sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps(sys.argv[1:]))
config.insert_json5("connect/timeout_ms", "-1")
with zenoh.open(config) as session:
    back = session.declare_publisher("pong", congestion_control=zenoh.CongestionControl.DROP)
    pings = session.declare_subscriber("ping", zenoh.handlers.FifoChannel(256))
    while True:
        sample = pings.recv()
        now = time.monotonic_ns() // 1000
        back.put(now.to_bytes(8, "big") + sample.payload.to_bytes()[8:])
"""
PATIENCE_S = 300.0
PACE_S = 0.02


@contextmanager
def started(*command: str) -> Iterator[None]:
    """Start a process and stop it at the end of the block."""
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        process.wait(10.0)


def awaited(box: Mailbox, key: str, within_s: float, plans: list[float]) -> Frame | None:
    """Return the next frame on ``key``; note the latencies of plans that arrive meanwhile."""
    deadline = time.monotonic() + within_s
    while (left := deadline - time.monotonic()) > 0:
        frame = box.take(left)
        if frame is not None and frame.key == "plan":
            plans.append(frame.received_monotonic_us - decode(Plan, frame.payload)[1].sent_monotonic_us)
        if frame is not None and frame.key == key:
            return frame
    return None


def row(name: str, times_us: list[float]) -> str:
    """Return one row of a table."""
    if not times_us:
        return f"| {name} | - | - | 0 |"
    median, high = np.percentile(times_us, [50, 99])
    return f"| {name} | {median:.0f} | {high:.0f} | {len(times_us)} |"


def main(messages: int) -> None:
    """Measure and print."""
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    there, ping, plans, answers = list[float](), list[float](), list[float](), list[float]()
    with (
        started(*CLI, "router", "--listen", endpoint),
        started(*CLI, "controller", "--connect", endpoint, "--reference", "hover"),
        started(sys.executable, "-P", "-c", ECHO, endpoint),
        open_session(BusOptions(connect=(endpoint,)), stop=lambda: False, say=lambda _: None) as session,
    ):
        box = Mailbox()
        for key in ("pong", "plan", "acknowledged"):
            session.subscribe(key, None, box)
        out = Outbox(session, node="latency", epoch=1, kinds=(Estimate, Command))
        bare = session.publisher("ping").put
        deadline = time.monotonic() + PATIENCE_S
        while awaited(box, "plan", PACE_S, []) is None:
            if time.monotonic() > deadline:
                sys.exit("no plan came")
            out.publish(msgspec.structs.replace(Estimate.at_rest(north_m=1.0, depth_m=0.0), t_ns=time.time_ns()))
        while awaited(box, "pong", PACE_S, []) is None:
            bare(bytes(200))
        while awaited(box, "pong", 10 * PACE_S, []):
            pass
        for k in range(messages):
            out.publish(msgspec.structs.replace(Estimate.at_rest(north_m=1.0, depth_m=0.0), t_ns=time.time_ns()))
            sent_us = time.monotonic_ns() // 1000
            bare(bytes(200))
            if pong := awaited(box, "pong", 1.0, plans):
                there.append(int.from_bytes(pong.payload[:8], "big") - sent_us)
                ping.append(pong.received_monotonic_us - sent_us)
            if k % 5 == 0:
                sent_us = time.monotonic_ns() // 1000
                out.publish(Command(command_id=k, action=Action.ARM if k == 0 else Action.HOLD, force=True))
                if answer := awaited(box, "acknowledged", 1.0, plans):
                    assert decode(Acknowledgement, answer.payload)[0].command_id == k
                    answers.append(answer.received_monotonic_us - sent_us)
            awaited(box, "plan", PACE_S, plans)
    print("| | median (us) | 99th percentile (us) | messages |\n|---|---|---|---|")
    print(row("bare ping, one way", there))
    print(row("plan, one way", plans))
    print(row("bare ping, there and back", ping))
    print(row("command and its answer, a cycle between", answers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=500)
    main(parser.parse_args().messages)
