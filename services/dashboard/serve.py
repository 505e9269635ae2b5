"""Server process of the live page (``ltv-mpc dashboard``): subscribes to a bus, serves the page, prints its address.

Nobody can occupy all sockets: a connection ends after ``IDLE_S`` in which it made no whole request and took no more of
an answer. The one above ``MAX_SOCKETS`` takes the place of the oldest, of those without a request first. What became a
WebSocket is not counted idle here: the server's pings end it.
"""

from __future__ import annotations

import asyncio
import os
import socket
import sys
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path

import msgspec
import uvicorn
from starlette.applications import Starlette
from uvicorn.protocols.http.h11_impl import H11Protocol

from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.session import open_session
from services.dashboard import page
from services.dashboard.access_guard import LOOPBACK, Token, headers, hosts
from services.dashboard.bus_feed import BusFeed
from services.dashboard.config import Config, View
from services.reporting.static_files import report_scripts
from services.runtime.console import Console
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

IDLE_S = 10.0
MAX_SOCKETS = 200


class Connection(H11Protocol):
    """HTTP connection with an end."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin; end the oldest of too many."""
        super().connection_made(transport)
        self._since_s, self._resumed = self.loop.time(), 0
        others = [one for one in self.connections if isinstance(one, Connection) and one is not self]
        if others and len(self.connections) > MAX_SOCKETS:
            min(others, key=lambda one: (one.cycle is not None, one._since_s)).transport.abort()
        self.loop.call_later(IDLE_S, self._check, None)

    def resume_writing(self) -> None:
        """Note that the client takes more of an answer."""
        self._resumed += 1
        super().resume_writing()

    def _check(self, before: object) -> None:
        """End the connection if nothing has happened since the last check."""
        if self.transport.is_closing() or self.transport.get_protocol() is not self:
            return
        state = self.cycle, self._resumed, self.transport.get_write_buffer_size()
        if state == (before or (None, 0, 0)):
            self.transport.abort()
        else:
            self.loop.call_later(IDLE_S, self._check, state)


GRACE_S = 1
PING_S = IDLE_S / 2
"""Time between pings of a WebSocket, and longest time to the answer, which every browser gives."""

NICE = 10
AUTOGROUP = Path("/proc/self/autogroup")
"""Priority of the session: Linux first divides processor time between sessions; each process of a run has its own."""


def listen(host: str, port: int) -> socket.socket:
    """Return a socket bound to host and port; port 0 takes any free one. Raises ``ConfigError`` if this fails."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((host, port))
    except OSError as error:
        bound.close()
        where = f"{host}:{port}"
        raise ConfigError("option --port", "", f"cannot listen there ({error.strerror})", value=where) from None
    return bound


def main(config: Config) -> int:
    """Serve the page until a stop is requested."""
    bus, host = config.bus, config.host
    vehicle = None if config.vehicle is None else Vehicle.load(config.vehicle)
    token = Token()

    def work(request: StopRequest, say: Say) -> None:
        with listen(host, config.port) as bound, open_session(bus, stop=request, say=say) as session:
            port = bound.getsockname()[1]
            named = f"[{host}]" if ":" in host else host
            feed = BusFeed(session, vehicle)
            app = page.make(
                feed,
                token,
                allowed=hosts({*LOOPBACK, named}, port),
                about=msgspec.structs.replace(config.about, bus=bus.namespace or ", ".join(bus.connects_to)),
                bus=bus,
                on_view=_write if config.of_a_run else lambda _: None,
            )
            bound.listen()  # clients that connect before the server runs wait for it
            if config.of_a_run:
                _give_way()
                threading.Thread(target=_read_preparations, args=(feed,), name="preparations", daemon=True).start()
            _announce(f"http://{named}:{port}/#{token.text}", config)
            # a signal ends the server, which then passes it to the previous handlers
            uvicorn.Server(configuration(app)).run(sockets=[bound])

    return run_until_stopped(Console("dashboard"), work)


def _give_way() -> None:
    os.nice(NICE)
    with suppress(OSError):  # the file is missing on systems without session scheduling
        AUTOGROUP.write_text(str(NICE))


def _announce(url: str, config: Config) -> None:
    _write(url)
    if config.open_browser and webbrowser.open(url) and config.of_a_run:
        _write(View.OPENED)  # it soon will


def _write(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _read_preparations(feed: BusFeed) -> None:
    """Show each line of the standard input until it ends."""
    with open(0, closefd=False) as lines:
        for line in lines:
            feed.preparation = line.strip()


def configuration(app: Starlette) -> uvicorn.Config:
    """Return the server configuration for a page on one machine."""
    return uvicorn.Config(
        app,
        log_level="error",
        access_log=False,
        http=Connection,
        ws_max_size=page.MAX_COMMAND_BYTES,
        ws_ping_interval=PING_S,
        ws_ping_timeout=PING_S,
        ws_per_message_deflate=False,  # loopback has bandwidth; the other processes need the processor time
        timeout_graceful_shutdown=GRACE_S,
        headers=headers(report_scripts()),
        server_header=False,
        proxy_headers=False,
    )
