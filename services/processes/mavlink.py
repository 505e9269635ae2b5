"""MAVLink process: the edge to ArduPilot between a session of this bus and a UDP socket."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

import msgspec

from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.outbox import new_epoch
from services.bus.session import BusError, open_session
from services.edges.edge import Outgoing
from services.edges.mavlink.codec import Codec
from services.edges.mavlink.edge import MavlinkEdge, Settings
from services.processes.edge_loop import EdgeLoop
from services.runtime.console import Console
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

MAX_DATAGRAM = 65_536
PERIOD_US = 50_000
SIGNING_EPOCH_S = 1_420_070_400  # 2015-01-01, from which the stamps of signatures count


class Config(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of the process."""

    bus: BusOptions
    host: str
    port: int
    listens: bool  # udpin: the autopilot sends to this address; else the edge sends to it first
    edge: Settings
    signing_key: bytes | None = None


def main(config: Config) -> int:
    """Translate until a stop is requested. Return the exit code."""
    return run_until_stopped(Console(MavlinkEdge.name), lambda request, say: _run(config, request, say))


def _run(config: Config, request: StopRequest, say: Say) -> None:
    mailbox = Mailbox()
    request.on_request(mailbox.wake)
    stamp = round((time.time() - SIGNING_EPOCH_S) * 1e5)
    codec = Codec(config.edge.ground_station, config.signing_key, stamp=stamp)
    with (
        open_session(config.bus, stop=request, say=say) as session,
        UdpLink(config.host, config.port, mailbox, listens=config.listens) as link,
    ):
        epoch = new_epoch()
        edge = MavlinkEdge(epoch, config.edge, codec)
        way = "listens at" if config.listens else "sends to"
        say(
            f"{way} udp {config.host}:{config.port}; watches ground station {config.edge.ground_station}, "
            f"thrusters of {config.edge.vehicle.name}"
        )
        EdgeLoop(edge, session, mailbox, epoch, say).run(link, PERIOD_US, request)


class UdpLink:
    """UDP socket to one peer: the given address, or for ``listens`` the newest sender."""

    def __init__(self, host: str, port: int, mailbox: Mailbox, *, listens: bool) -> None:
        """Bind or connect. Raises ``BusError``."""
        self._mailbox = mailbox
        self._peer: tuple[str, int] | None = None if listens else (host, port)
        self._listens = listens
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port) if listens else ("", 0))
        except OSError as error:
            self._socket.close()
            raise BusError(f"cannot listen at udp {host}:{port}: {error.strerror}") from None
        self._socket.settimeout(0.2)
        self._open = True
        self._thread = threading.Thread(target=self._receive, name="udp", daemon=True)

    def __enter__(self) -> UdpLink:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._open = False
        self._thread.join()
        self._socket.close()

    def send(self, frame: Outgoing) -> None:
        """Send a datagram; one that cannot be sent is dropped."""
        if self._peer is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(frame.payload, self._peer)

    def _receive(self) -> None:
        while self._open:
            try:
                payload, peer = self._socket.recvfrom(MAX_DATAGRAM)
            except OSError:  # a time-out, or an answer that nobody listens there
                continue
            if self._listens:
                self._peer = peer
            self._mailbox.offer(None, "", payload)
