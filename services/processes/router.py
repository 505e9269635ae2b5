"""The router process: passes messages between all others, and knows nothing of them.

With certificates it also denies what no role allows, and says on the bus how much that was.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator

import msgspec

from ltv_mpc.messages import Clock, NodeStatus, RunEvent
from services.bus.denials import LOG_FILTER, Denials
from services.bus.outbox import Outbox, new_epoch
from services.bus.roles import ROUTER
from services.bus.session import BusOptions, Session, log_to_stdout, open_session
from services.bus.topics import BY_TYPE, Topic
from services.bus.wire import WireError, decode
from services.runtime.clock import ClockError, VehicleClock, monotonic_us
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest
from services.runtime.supervisor_link import HEARTBEAT_PERIOD_US, SUPERVISOR_LINK

STATUS_US = 500_000
PULSE_S = HEARTBEAT_PERIOD_US / 1e6
STDOUT = 1
PAUSE_S = 0.05
"""Between two looks at Zenoh's log: it comes in lines, some thousand a second, and is read in blocks."""

LOG_BYTES = 1 << 20
"""Of the pipe between: what Zenoh logs while nobody looks. Once full it would hold up the messages."""


class Config(msgspec.Struct, frozen=True, kw_only=True):
    """What the router process needs to start."""

    bus: BusOptions


def main(config: Config) -> int:
    """Route until told to stop; by default at the place where the others look."""
    bus = config.bus
    endpoints = bus.listen or (bus.usual_endpoint,)
    secure = bus.certs is not None
    namespace = bus.namespace if secure else ""  # in which the rights hold, and where it says what it has denied
    options = msgspec.structs.replace(bus, listen=endpoints, mode=bus.mode or "router", namespace=namespace)

    def work(request: StopRequest, say: Say) -> None:
        SUPERVISOR_LINK.state()
        if secure:
            _guard(options, request, say)
            return
        with open_session(options, stop=request, say=say):
            say(f"ready at {', '.join(endpoints)}")
            while not request.wait(PULSE_S):
                SUPERVISOR_LINK.beat(monotonic_us())

    return run_until_stopped(ROUTER, work)


def _guard(options: BusOptions, request: StopRequest, say: Say) -> None:
    """Route for those who have a role, and tell of the others."""
    denials = Denials()
    with _zenoh_log(denials), open_session(options, stop=request, say=say) as session:
        report = _Report(session, denials, say)
        say(f"ready at {', '.join(options.listen)}")
        due_us = 0
        while not request.wait(PULSE_S):
            now_us = monotonic_us()
            SUPERVISOR_LINK.beat(now_us)
            if now_us >= due_us:
                due_us = now_us + STATUS_US
                report.publish()
        report.publish(finished=True)


class _Report:
    """The router's word: a heartbeat with the number of denied attempts, and an event when there were more of them.

    On the bus it waits for the first word of another, so that nothing is said before a recorder listens.
    """

    def __init__(self, session: Session, denials: Denials, say: Say) -> None:
        self._denials = denials
        self._say = say
        self._said = 0
        self._heard = False
        self._clock = VehicleClock()
        self._out = Outbox(session, node=ROUTER, epoch=new_epoch(), kinds=(NodeStatus, RunEvent))
        session.subscribe(f"{BY_TYPE[NodeStatus].key}/*", BY_TYPE[NodeStatus], self)
        session.subscribe(BY_TYPE[Clock].key, BY_TYPE[Clock], self)

    def offer(self, topic: Topic | None, _key: str, payload: bytes) -> None:
        """Hear another's status, or the clock; called on Zenoh's thread."""
        self._heard = True
        if topic is BY_TYPE[Clock]:
            with contextlib.suppress(WireError, ClockError):  # its followers say so
                self._clock.follow(decode(Clock, payload)[0])

    def publish(self, *, finished: bool = False) -> None:
        """Say it now."""
        if not self._heard:
            return
        t_ns = self._clock.read(monotonic_us()) or 0
        total = self._denials.total
        if total > self._said:
            text = f"denied {total} attempts so far: {self._denials}"
            self._say(text)
            self._out.publish(RunEvent(t_ns=t_ns, node=ROUTER, kind="denied", text=text))
            self._said = total
        self._out.publish(
            NodeStatus(
                node=ROUTER,
                t_ns=t_ns,
                ready=True,
                waiting_for="",
                steps=0,
                published=self._out.published + 1,  # this one included
                received=0,
                dropped=0,
                rejected=total,
                step_us=0.0,
                finished=finished,
            )
        )


@contextlib.contextmanager
def _zenoh_log(denials: Denials) -> Iterator[None]:
    """What Zenoh logs, which it can to standard output only, goes to ``denials`` while this lasts."""
    log, into = os.pipe()
    _widen(into)
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
        os.dup2(before, STDOUT)  # the last way into the pipe: the reader finds its end
        os.close(before)
        ended.set()
        reader.join()
        os.close(log)


def _widen(pipe: int) -> None:
    import fcntl

    if hasattr(fcntl, "F_SETPIPE_SZ"):  # Linux
        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, LOG_BYTES)
