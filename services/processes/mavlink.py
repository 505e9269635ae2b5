"""MAVLink process: the edge to ArduPilot between a session of this bus and a UDP socket."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Iterator

import msgspec

from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.outbox import new_epoch
from services.bus.session import BusError, open_session
from services.edges.edge import Outgoing
from services.edges.mavlink.codec import MARKERS, Codec
from services.edges.mavlink.edge import MavlinkEdge, Settings
from services.processes.edge_loop import EdgeLoop, SenderLimit
from services.runtime.console import Console
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

MAX_DATAGRAM = 65_536
PERIOD_US = 50_000
FROM_STRANGER, STRANGERS = 100, 20
"""Datagrams a second of one sender, and senders, that are received: the autopilot is at first one of them."""
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
    """UDP socket to the given address, or for ``listens`` to the sender that a frame names as its channel.

    The sender that was answered last is the peer. It has a second socket at the same port, so that a flood by others
    takes no room in its queue. Of each of ``STRANGERS`` others, ``FROM_STRANGER`` datagrams a second are received.
    """

    def __init__(self, host: str, port: int, mailbox: Mailbox, *, listens: bool) -> None:
        """Bind the port. Raises ``BusError``."""
        self._mailbox = mailbox
        self._given = None if listens else (host, port)
        self._peer = ""
        self._strangers = SenderLimit(FROM_STRANGER, STRANGERS)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port) if listens else ("", 0))
        except OSError as error:
            self._socket.close()
            raise BusError(f"cannot listen at udp {host}:{port}: {error.strerror}") from None
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
        self._peer = frame.channel
        if self._given is not None or self._peer:
            with contextlib.suppress(OSError):
                self._socket.sendto(frame.payload, self._given or _address(self._peer))

    def _receive(self) -> None:
        peer, sockets = "", [self._socket]
        while self._open:
            if self._peer != peer:
                peer = self._peer
                for old in sockets[1:]:
                    old.close()
                sockets[1:] = self._of(peer) if peer else ()
            for one in select.select(sockets, (), (), 0.2)[0]:
                with contextlib.suppress(OSError):  # an answer that nobody listens there
                    self._offer(*one.recvfrom(MAX_DATAGRAM), peer)
        for old in sockets[1:]:
            old.close()

    def _of(self, peer: str) -> Iterator[socket.socket]:
        """Yield a socket to which the kernel gives what the peer sends; none where the system has no such thing."""
        own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        both = self._socket, own
        try:
            for one in both:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            own.bind(self._socket.getsockname())
            own.connect(_address(peer))
            yield own
        except OSError:
            own.close()
        finally:  # another process must not share the port
            for one in both:
                with contextlib.suppress(OSError):
                    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)

    def _offer(self, payload: bytes, address: tuple[str, int], peer: str) -> None:
        sender = f"{address[0]}:{address[1]}"
        if sender == peer or (payload[:1] in MARKERS and self._strangers.admits(sender, time.monotonic())):
            self._mailbox.offer(None, sender, payload)
        else:
            self._mailbox.overflowed += 1


def _address(sender: str) -> tuple[str, int]:
    host, _, port = sender.rpartition(":")
    return host, int(port)
