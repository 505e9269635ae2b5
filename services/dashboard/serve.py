"""``ltv-mpc dashboard``: hears a bus, serves the page on this machine, prints where."""

from __future__ import annotations

import os
import socket
import sys
import webbrowser
from contextlib import suppress
from pathlib import Path

import uvicorn
from starlette.applications import Starlette

from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.session import open_session
from services.dashboard import page
from services.dashboard.access_guard import LOOPBACK, Token, hosts
from services.dashboard.bus_feed import BusFeed
from services.dashboard.config import Config
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

GRACE_S = 1

NICE = 10
AUTOGROUP = Path("/proc/self/autogroup")
"""Where Linux shares the processor out by sessions, of which each process of a run is one, first."""


def listen(host: str, port: int) -> socket.socket:
    """A socket there; ``port`` 0 takes any. Raises ``ConfigError`` where that cannot be."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    made = socket.socket(family, socket.SOCK_STREAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((host, port))
    except OSError as error:
        made.close()
        where = f"{host}:{port}"
        raise ConfigError("option --port", "", f"cannot listen there ({error.strerror})", value=where) from None
    return made


def main(config: Config) -> int:
    """Serve until told to stop."""
    if config.gives_way:
        _give_way()
    bus, host = config.bus, config.host
    thrusters = None if config.vehicle is None else Vehicle.load(config.vehicle).thrusters[:2]
    token = Token()

    def work(request: StopRequest, say: Say) -> None:
        with listen(host, config.port) as place, open_session(bus, stop=request, say=say) as session:
            port = place.getsockname()[1]
            named = f"[{host}]" if ":" in host else host
            name = bus.namespace or ", ".join(bus.connects_to)
            app = page.make(
                BusFeed(session, thrusters),
                token,
                allowed=hosts({*LOOPBACK, named}, port),
                name=name,
                command=page.commander(bus),
            )
            place.listen()  # who comes before the server runs waits for it
            _announce(f"http://{named}:{port}/#{token.text}", open_browser=config.open_browser)
            # a signal ends it, and is then handed on to the handlers that were there before
            uvicorn.Server(configuration(app)).run(sockets=[place])

    return run_until_stopped("dashboard", work)


def _give_way() -> None:
    os.nice(NICE)
    with suppress(OSError):  # there is none where it is shared out by processes alone
        AUTOGROUP.write_text(str(NICE))


def _announce(url: str, *, open_browser: bool) -> None:
    sys.stdout.write(f"{url}\n")
    sys.stdout.flush()
    if open_browser:
        webbrowser.open(url)


def configuration(app: Starlette) -> uvicorn.Config:
    """uvicorn's, for one page on one machine."""
    return uvicorn.Config(
        app,
        log_level="error",
        access_log=False,
        ws_max_size=page.MAX_COMMAND_BYTES,
        ws_per_message_deflate=False,  # loopback has room; the other processes need the processor
        timeout_graceful_shutdown=GRACE_S,
        server_header=False,
        proxy_headers=False,
    )
