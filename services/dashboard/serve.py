"""``ltv-mpc dashboard``: hears a bus, serves the page on this machine, prints where."""

from __future__ import annotations

import socket
import sys
import webbrowser

import uvicorn
from starlette.applications import Starlette

from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Thruster
from services.bus.session import BusError, BusOptions, Stopped, open_session
from services.dashboard import page
from services.dashboard.ears import Ears
from services.dashboard.guard import LOOPBACK, Token, hosts
from services.process.stopping import DONE, FAILED, INTERRUPTED, sayer, stop_on_signals

GRACE_S = 1


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


def main(
    bus: BusOptions,
    *,
    host: str,
    port: int,
    thrusters: tuple[Thruster, Thruster] | None,
    open_browser: bool,
    name: str,
) -> int:
    """Until it is told to stop."""
    say = sayer("dashboard")
    token = Token()
    with stop_on_signals() as request, listen(host, port) as place:
        port = place.getsockname()[1]
        named = f"[{host}]" if ":" in host else host
        try:
            with open_session(bus, stop=request, say=say) as session:
                ears = Ears(session, thrusters)
                allowed = hosts({*LOOPBACK, named}, port)
                app = page.make(ears, token, allowed=allowed, name=name, command=page.commander(bus))
                place.listen()  # who comes before the server runs waits for it
                _tell(f"http://{named}:{port}/#{token.text}", open_browser=open_browser)
                # a signal ends it, and is then handed on to the handlers that were there before
                uvicorn.Server(configuration(app)).run(sockets=[place])
        except Stopped:
            pass
        except BusError as error:
            say(str(error))
            return FAILED
    return INTERRUPTED if request.interrupted else DONE


def _tell(url: str, *, open_browser: bool) -> None:
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
        ws_max_size=page.LONGEST_COMMAND_BYTES,
        ws_per_message_deflate=False,  # loopback has room; the other processes need the processor
        timeout_graceful_shutdown=GRACE_S,
        server_header=False,
        proxy_headers=False,
    )
