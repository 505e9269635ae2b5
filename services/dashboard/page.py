"""Web application of the live page: HTTP for the page itself, one WebSocket for its stream and its buttons.

    GET /            the page                 GET /page/NAME   its scripts and styles, and plotly's own
    GET /report      the report of the run; 204 before it is written. The page keeps it: this server ends with the run
    WS  /stream      to the browser: the texts of ``stream.py`` and a ``ButtonReply`` to each command;
                     from the browser: ``ButtonRequest``

Any client that ``access_guard.py`` accepts may read. Commands need the token.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import NamedTuple

import msgspec
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from ltv_mpc.errors import format_value
from services.bus.options import BusOptions
from services.dashboard.access_guard import AccessGuard, Token
from services.dashboard.bus_feed import BusFeed
from services.dashboard.commands import SIMULATED, Button, ButtonReply, ButtonRequest, do
from services.dashboard.config import About, View
from services.dashboard.stream import MAX_READERS, PERIOD_S, Reader, Stream
from services.reporting import static_files
from services.reporting.plots import palette
from services.reporting.plots.catalogue import PLOTS

HERE = Path(__file__).parent / "static"

_SAFE = static_files.safe_part(
    facts="",
    processes="",
    events="",
    ages='<p class="quiet" id="ages"></p>',
    command='<th><span class="hidden">command</span></th>',
)

OnView = Callable[[View], object]
"""Is called with what browsers do with the page."""

REQUEST = msgspec.json.Decoder(ButtonRequest)
TOKEN_S = 5.0
"""Longest wait for the token of a browser for which no other place is left."""

MAX_COMMAND_BYTES = 1024
"""Largest command; the server closes the connection of a client that sends more."""


def make(
    feed: BusFeed, token: Token, *, allowed: frozenset[str], about: About, bus: BusOptions, on_view: OnView
) -> Starlette:
    """Return the application. ``allowed`` are the accepted Host headers; commands go to ``bus``."""
    stream = Stream(feed)
    index = static_files.filled((HERE / "index.html").read_text(encoding="utf-8"), safe=_SAFE)
    files = {
        "live.js": HERE / "live.js",
        "live.css": HERE / "live.css",
        "plots.js": static_files.HERE / "plots.js",
        "style.css": static_files.HERE / "style.css",
        "plotly.js": static_files.plotly_path(),
    }

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(stream.run())
        yield
        task.cancel()

    async def page(_: Request) -> Response:
        on_view(View.OPENED)
        return HTMLResponse(index)

    async def file(request: Request) -> Response:
        path = files.get(request.path_params["name"])
        return Response("no such file\n", 404) if path is None else FileResponse(path)

    async def report(_: Request) -> Response:
        path = Path(about.report)
        return FileResponse(path) if path.is_file() else Response(status_code=204)

    async def live(socket: WebSocket) -> None:
        await _live(socket, _Commands(feed, stream, token, bus, on_view), about)

    return Starlette(
        routes=[
            Route("/", page),
            Route("/page/{name}", file),
            Route("/report", report),
            WebSocketRoute("/stream", live),
        ],
        middleware=[Middleware(AccessGuard, allowed=allowed)],
        lifespan=lifespan,
    )


class _Commands(NamedTuple):
    """Objects that answer the commands of the browsers."""

    feed: BusFeed
    stream: Stream
    token: Token
    bus: BusOptions
    on_view: OnView

    def look_at_readers(self) -> None:
        """Say so if no browser is there any more, or if each has the report."""
        readers = self.stream.readers
        if not readers:
            self.on_view(View.CLOSED)
        elif all(reader.has_report for reader in readers):
            self.on_view(View.HAS_REPORT)


async def _live(socket: WebSocket, commands: _Commands, about: About) -> None:
    """Serve one browser until it disconnects."""
    await socket.accept()
    stream = commands.stream
    reader = Reader()
    hello = {"kind": "hello", "about": about, "plots": PLOTS, "dark": palette.DARK}
    await socket.send_text(msgspec.json.encode(hello).decode())
    work = [_send(socket, reader, stream), _obey(socket, reader, commands)]
    if not stream.admit(reader):
        work.append(_await_token(socket, reader))
    tasks = [asyncio.create_task(one) for one in work]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        stream.leave(reader)
        commands.look_at_readers()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _await_token(socket: WebSocket, reader: Reader) -> None:
    """Close the connection if the browser does not send the token soon: no place is left without it."""
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(reader.evicted.wait(), TOKEN_S)
    if reader.has_token:
        await asyncio.Event().wait()
    await socket.close(1013, f"{MAX_READERS} pages are open already, which is the limit without the token")


async def _send(socket: WebSocket, reader: Reader, stream: Stream) -> None:
    while True:
        if reader in stream.readers:
            await socket.send_text(stream.next_text(reader))
        await asyncio.sleep(PERIOD_S)


async def _obey(socket: WebSocket, reader: Reader, commands: _Commands) -> None:
    """Execute the commands of a browser one after the other."""
    with contextlib.suppress(WebSocketDisconnect):
        while True:
            reply = await _reply(await socket.receive_text(), reader, commands)
            if reply is not None:
                await socket.send_text(msgspec.json.encode(reply).decode())


async def _reply(text: str, reader: Reader, commands: _Commands) -> ButtonReply | None:
    """Return the reply to a command; None to a heartbeat, and to what the page says of itself."""
    feed = commands.feed
    try:
        request = REQUEST.decode(text)
    except ValueError as error:  # includes the errors of msgspec
        return ButtonReply(number=0, done=False, text=f"no such command: {error}")
    if (has_token := commands.token.matches(request.token)) and not reader.has_token:
        reader.has_token = True
        commands.stream.admit(reader)
    if request.button is Button.HAS_REPORT:
        reader.has_report = True
        commands.look_at_readers()
        return None
    if request.button is Button.DRAWN:
        if not reader.has_report:
            commands.on_view(View.DRAWN)
        return None
    refused = ""
    moment = feed.status()
    known = [process["name"] for process in moment.processes]
    if not has_token:
        refused = "read-only: open the printed address, which carries the token"
    elif request.button in SIMULATED and not moment.simulated:
        refused = f"{request.button.value} works in a simulation only"
    elif request.button is Button.KILL and request.node not in known:
        refused = f"kill refused: {format_value(request.node)}: must be one of {', '.join(known)}"
    if refused:
        return ButtonReply(number=request.number, done=False, text=refused)
    if request.button is Button.HEARTBEAT:
        feed.beat()
        return None
    return await asyncio.to_thread(do, request, commands.bus, feed.t_ns(), moment.requested_speed)
