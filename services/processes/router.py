"""Router process: passes messages between all other processes.

With certificates it also denies what no role allows, and reports the number of denials on the bus.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import threading
from collections.abc import Iterator

import msgspec

from ltv_mpc.messages import Clock, NodeStatus, RunEvent
from services.bus.denials import LOG_FILTER, Denials
from services.bus.outbox import Outbox, new_epoch
from services.bus.roles import ROUTER
from services.bus.session import Session, log_to_stdout, open_session
from services.bus.topics import BY_TYPE, Topic
from services.bus.wire import WireError, decode
from services.processes import settings
from services.runtime.clock import ClockError, VehicleClock, monotonic_us
from services.runtime.console import Console, tenfold
from services.runtime.lifeline import HEARTBEAT_PERIOD_US, LIFELINE
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

Config = settings.Router


STATUS_US = 500_000
PULSE_S = HEARTBEAT_PERIOD_US / 1e6
STDOUT = 1
PAUSE_S = 0.05
"""Pause between two reads of Zenoh's log, which has some thousand lines a second and is read in blocks."""

LOG_BYTES = 1 << 20
"""Size of the log's pipe, for the lines between two reads. A full pipe would block the router."""


def main(config: Config) -> int:
    """Route until a stop is requested; by default at the address to which the other processes connect."""
    bus = config.bus
    endpoints = bus.listen or (bus.usual_endpoint,)
    secure = bus.certs is not None
    namespace = bus.namespace if secure else ""  # in which the rights hold and denials are reported
    options = msgspec.structs.replace(bus, listen=endpoints, mode=bus.mode or "router", namespace=namespace)

    def work(request: StopRequest, say: Say) -> None:
        denials, due_us = Denials(), 0
        log = _zenoh_log(denials) if secure else contextlib.nullcontext()
        with log, open_session(options, stop=request, say=say) as session:
            report = _Report(session, denials, say) if secure else None
            say(f"ready at {', '.join(endpoints)}")
            while not request.wait(PULSE_S):
                now_us = monotonic_us()
                LIFELINE.beat(now_us)
                if report is not None and now_us >= due_us:
                    due_us = now_us + STATUS_US
                    report.publish()
            if report is not None:
                report.publish(finished=True)

    return run_until_stopped(Console(ROUTER, as_json=config.log_json), work)


class _Report:
    """Status of the router with the number of denials; an event at the first one, at 10, 100, ..., and at the end.

    It starts to publish after the first message of another process, so that a recorder does not miss a message.
    """

    def __init__(self, session: Session, denials: Denials, say: Say) -> None:
        self._denials = denials
        self._say = say
        self._reported = 0
        self._others_run = False
        self._clock = VehicleClock()
        self._out = Outbox(session, node=ROUTER, epoch=new_epoch(), kinds=(NodeStatus, RunEvent))
        session.subscribe(f"{BY_TYPE[NodeStatus].key}/*", BY_TYPE[NodeStatus], self)
        session.subscribe(BY_TYPE[Clock].key, BY_TYPE[Clock], self)

    def offer(self, topic: Topic | None, _key: str, payload: bytes) -> None:
        """Take the status of another process, or the clock; called on Zenoh's thread."""
        self._others_run = True
        if topic is BY_TYPE[Clock]:
            with contextlib.suppress(WireError, ClockError):  # the processes that follow the clock report it
                self._clock.follow(decode(Clock, payload)[0])

    def publish(self, *, finished: bool = False) -> None:
        """Publish the status."""
        if not self._others_run:
            return
        t_ns = self._clock.read(monotonic_us()) or 0
        total = self._denials.total
        if tenfold(total) > tenfold(self._reported) or (finished and total > self._reported):
            text = f"denied {total} attempts so far: {self._denials}"
            self._say(text)
            self._out.publish(RunEvent(t_ns=t_ns, node=ROUTER, kind="denied", text=text))
            self._reported = total
        published = self._out.published + 1  # this one included
        status = NodeStatus(node=ROUTER, t_ns=t_ns, ready=True, published=published, rejected=total, finished=finished)
        self._out.publish(status)


@contextlib.contextmanager
def _zenoh_log(denials: Denials) -> Iterator[None]:
    """Redirect Zenoh's log, which goes to standard output only, to ``denials`` in this context."""
    log, into = os.pipe()
    fcntl.fcntl(into, fcntl.F_SETPIPE_SZ, LOG_BYTES)
    before = os.dup(STDOUT)
    os.dup2(into, STDOUT)
    os.close(into)
    ended = threading.Event()

    def read() -> None:
        while block := os.read(log, LOG_BYTES):
            denials.read(block)
            ended.wait(PAUSE_S)

    reader = threading.Thread(target=read, name="log", daemon=True)
    reader.start()
    log_to_stdout(LOG_FILTER)
    try:
        yield
    finally:
        os.dup2(before, STDOUT)  # closes the pipe's last writer, so the reader reaches its end
        os.close(before)
        ended.set()
        reader.join()
        os.close(log)
