"""MAVLink process: the edge to ArduPilot between a session of this bus and a UDP socket."""

from __future__ import annotations

import contextlib
import re
import select
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from ltv_mpc.config import read_bytes
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Mailbox
from services.bus.options import invalid
from services.bus.outbox import new_epoch
from services.bus.rate_limit import SourceLimit
from services.bus.session import BusError, open_session
from services.edges.edge import Outgoing
from services.edges.mavlink.codec import MARKERS, Codec
from services.edges.mavlink.edge import MavlinkEdge, Settings
from services.edges.mavlink.navigation import Accuracy
from services.processes import settings
from services.processes.edge_loop import EdgeLoop
from services.runtime.clock import monotonic_us
from services.runtime.console import Console
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

MAX_DATAGRAM = 65_536
PERIOD_US = 50_000
FROM_STRANGER, STRANGERS = 100, 20
"""Datagrams a second of one sender, and senders, that are received: the autopilot is at first one of them."""
SIGNING_EPOCH_S = 1_420_070_400  # 2015-01-01, from which the stamps of signatures count


Config = settings.Mavlink


def main(config: Config) -> int:
    """Translate until a stop is requested. Return the exit code. Raises ``ConfigError``."""
    host, port, listens = _autopilot(config.autopilot)
    vehicle, system = Vehicle.load(config.vehicle), config.gcs_sysid
    sides = ("port", vehicle.thruster.port), ("starboard", vehicle.thruster.starboard)
    if missing := [name for name, thruster in sides if not thruster.pwm_us]:
        problem = f"[thruster.{missing[0]}] has no pwm_us and pwm_N: the vehicle bluerobotics-boat has them"
        raise invalid(f"vehicle {config.vehicle}", problem)
    key = None if config.signing_key is None else _key(config.signing_key)
    edge = Settings(
        vehicle=vehicle, ground_station=system, accuracy=_accuracy(config.sd), follow_mission=not config.no_mission
    )

    def work(request: StopRequest, say: Say) -> None:
        mailbox, epoch = Mailbox(), new_epoch()
        request.on_request(mailbox.wake)
        codec = Codec(system, key, stamp=round((time.time() - SIGNING_EPOCH_S) * 1e5))
        with (
            open_session(config.bus, stop=request, say=say) as session,
            UdpLink(host, port, mailbox, listens=listens) as link,
        ):
            way = "listens at" if listens else "sends to"
            say(f"{way} udp {host}:{port}; watches ground station {system}, thrusters of {vehicle.name}")
            EdgeLoop(MavlinkEdge(epoch, edge, codec), session, mailbox, epoch, say).run(link, PERIOD_US, request)

    return run_until_stopped(Console(MavlinkEdge.name, as_json=config.log_json), work)


def _accuracy(text: str) -> Accuracy:
    """Return the standard deviations of a text. Raises ``ConfigError``."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 4 or not all(0.0 < value < 1e3 for value in values):
        raise invalid("option --sd", "must be four numbers above 0, as in 1,0.1,0.05,0.01", value=text)
    return Accuracy(*values)


def _key(path: Path) -> bytes:
    """Return the 32 bytes of a file. Raises ``ConfigError``."""
    key = read_bytes(path, what="option --signing-key")
    if len(key) != 32:
        raise invalid(f"option --signing-key {path}", f"has {len(key)} bytes, must be 32")
    return key


def _autopilot(text: str) -> tuple[str, int, bool]:
    """Return host, port, and whether the edge listens there. Raises ``ConfigError``."""
    found = re.fullmatch("(udpin|udpout):(.+):([0-9]{1,5})", text)
    if found is None or not 1 <= int(found[3]) <= 65_535:
        problem = "must be udpin:HOST:PORT or udpout:HOST:PORT, as in udpin:127.0.0.1:14550"
        raise invalid("option --autopilot", problem, value=text)
    return found[2], int(found[3]), found[1] == "udpin"


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
        self._strangers = SourceLimit(FROM_STRANGER, STRANGERS)
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
        if sender == peer or (payload[:1] in MARKERS and self._strangers.admits(sender, monotonic_us())):
            self._mailbox.offer(None, sender, payload)
        else:
            self._mailbox.overflowed += 1


def _address(sender: str) -> tuple[str, int]:
    host, _, port = sender.rpartition(":")
    return host, int(port)
