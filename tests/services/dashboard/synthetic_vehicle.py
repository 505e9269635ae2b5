"""Synthetic vehicle on a real bus: it publishes what the live page shows and receives what its buttons send."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import uvicorn
from msgspec.structs import replace

from ltv_mpc import messages
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.session import Session, open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import decode
from services.dashboard import page, serve
from services.dashboard.access_guard import LOOPBACK, Token, hosts
from services.dashboard.bus_feed import BusFeed
from services.dashboard.config import About, View
from services.recording.node_settings import vehicle_of
from services.runtime.clock import fraction_of, monotonic_us
from tests.services.reporting import synthetic_run
from tests.services.reporting.synthetic_run import EPOCH, NODES, S
from tests.services.words import status
from tests.waiting import until

K = TypeVar("K", bound=messages.Message)

SPEED = 10


class SyntheticVehicle:
    """Publisher of the dive of ``synthetic_run`` at ten times real time; it obeys clock commands and commands."""

    def __init__(self, session: Session) -> None:
        self.received: list[messages.Message] = []
        self.clock_epoch = EPOCH
        self.finished = False
        """True once the plant has finished, as at the end of a run."""
        self._box = Mailbox()
        for kind in (messages.Command, messages.ClockCommand, messages.Disturbance, messages.Heartbeat, messages.Kill):
            session.subscribe(BY_TYPE[kind].key, BY_TYPE[kind], self._box)
        self._out = synthetic_run.outboxes(session)
        self._clock = synthetic_run.clock(-S)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._go, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()

    def publish(self, node: str, signal: messages.Message) -> None:
        self._out[node].publish(signal)

    def received_of(self, kind: type[K]) -> list[K]:
        return [signal for signal in self.received if isinstance(signal, kind)]

    def restart(self) -> None:
        """Start another run at the same vehicle time: only the epoch of the clock changes."""
        self.clock_epoch += 1
        self.announce(vehicle_ns=self._now_ns(), state=messages.ClockState.RUNNING, speed=SPEED)

    def announce(self, *, vehicle_ns: int, state: messages.ClockState, speed: float) -> None:
        num, den = fraction_of(speed).as_integer_ratio()
        self._clock = replace(
            self._clock,
            clock_epoch=self.clock_epoch,
            clock_sequence=self._clock.clock_sequence + 1,
            at_monotonic_us=monotonic_us(),
            vehicle_ns=vehicle_ns,
            speed_num=num,
            speed_den=den,
            requested_speed=num / den,
            state=state,
        )

    def _go(self) -> None:
        self.announce(vehicle_ns=-S, state=messages.ClockState.RUNNING, speed=SPEED)
        dive = synthetic_run.dive(10_000.0)
        waiting = next(dive)
        turn = 0
        while not self._stop.wait(0.05):
            turn += 1
            self._obey()
            if turn % 10 == 1:
                for node in NODES:
                    finished = self.finished and node == "plant"
                    self.publish(node, status(node, t_ns=self._now_ns(), finished=finished))
            self.publish("plant", self._clock)
            while waiting[2] <= self._now_ns():
                if not isinstance(waiting[1], messages.Clock):
                    self.publish(waiting[0], waiting[1])
                waiting = next(dive)

    def _now_ns(self) -> int:
        clock = self._clock
        if clock.state is not messages.ClockState.RUNNING:
            return clock.vehicle_ns
        return clock.vehicle_ns + (monotonic_us() - clock.at_monotonic_us) * 1000 * clock.speed_num // clock.speed_den

    def _obey(self) -> None:
        while (frame := self._box.take(0.0)) is not None:
            assert frame.topic is not None
            signal, header = decode(frame.topic.message_type, frame.payload)
            if header.epoch == EPOCH:  # the dive's own
                continue
            self.received.append(signal)
            if isinstance(signal, messages.ClockCommand):
                state = messages.ClockState.PAUSED if signal.paused else messages.ClockState.RUNNING
                self.announce(vehicle_ns=self._now_ns(), state=state, speed=signal.speed)
            if isinstance(signal, messages.Command):
                answer = messages.Acknowledgement(
                    t_ns=self._now_ns(),
                    command_id=signal.command_id,
                    accepted=signal.action != "hold",
                    authority=messages.Authority.CONTROLLER,
                    why="nothing to hold" if signal.action == "hold" else "",
                )
                self.publish("controller", answer)


@dataclass
class Served:
    """Running page of a bus feed, and the vehicle behind it if it has one."""

    feed: BusFeed
    token: str
    port: int
    server: uvicorn.Server
    views: list[View]
    report: Path  # file of the run's report; missing until a test writes it
    vehicle: SyntheticVehicle = field(init=False)

    @property
    def host(self) -> str:
        return f"127.0.0.1:{self.port}"

    @property
    def url(self) -> str:
        return f"http://{self.host}/"

    def cut(self) -> None:
        """Cut every connection, as a network failure does."""
        for connection in tuple(self.server.server_state.connections):
            one: Any = connection  # each of uvicorn's protocols has both
            one.loop.call_soon_threadsafe(one.transport.abort)


@contextmanager
def serving(feed: BusFeed, bus: BusOptions) -> Iterator[Served]:
    """Serve the page of a feed; its buttons act on ``bus``."""
    with serve.listen("127.0.0.1", 0) as place, tempfile.TemporaryDirectory() as folder:
        place.listen()
        report = Path(folder) / "report.html"
        port, token, views = place.getsockname()[1], Token(), list[View]()
        app = page.make(
            feed,
            token,
            allowed=hosts(LOOPBACK, port),
            about=About(name="synthetic descent · paper", report=str(report), again="ltv-mpc sim one"),
            bus=bus,
            on_view=views.append,
        )
        server = uvicorn.Server(serve.configuration(app))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [place]}, daemon=True)
        thread.start()
        try:
            until(lambda: server.started)
            yield Served(feed, token.text, port, server, views, report)
        finally:
            server.should_exit = True
            thread.join(10)


@contextmanager
def sessions(router_port: int) -> Iterator[tuple[Session, Session, BusOptions]]:
    """Run a router and two sessions in this process; yield these, aboard and ashore, and the options of another one."""
    endpoint = f"tcp/127.0.0.1:{router_port}"
    reached = BusOptions(connect=(endpoint,))

    def opened(options: BusOptions) -> Session:
        return open_session(options, stop=lambda: False, say=lambda _: None)

    with opened(BusOptions(listen=(endpoint,))), opened(reached) as aboard, opened(reached) as ashore:
        yield aboard, ashore, reached


@contextmanager
def served(router_port: int) -> Iterator[Served]:
    """Run router, vehicle and page in this process, each with its own session."""
    with sessions(router_port) as (aboard, ashore, reached):
        feed = BusFeed(ashore, vehicle_of({"config/vehicle.toml": synthetic_run.VEHICLE}))
        with serving(feed, reached) as shown, closing(SyntheticVehicle(aboard)) as shown.vehicle:
            yield shown
