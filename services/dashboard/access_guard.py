"""Who may read the page and who may command: any web page in the same browser can send requests to this machine.

Host     a name of this machine's page must be in it: else a foreign name that was pointed at this machine's address
         (DNS rebinding) would make the page a foreign page's own
Origin   where a browser sends one, it is the page itself; every WebSocket has to have it, since browsers let any page
         open one to anywhere
token    192 random bits in the printed URL, behind its #, which no browser sends: commands hold it, reading does not
         need it
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Iterable

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
TOKEN_BYTES = 24

HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src data: blob:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
"""Of every answer. plotly sets styles, so these may stand in the page; scripts may not."""


class Token:
    """The secret of one start of the page's process."""

    def __init__(self) -> None:
        self.text = secrets.token_urlsafe(TOKEN_BYTES)

    def matches(self, text: str) -> bool:
        """In a time that tells nothing about how much of it is right."""
        return hmac.compare_digest(self.text.encode(), text.encode(errors="replace"))


def hosts(names: Iterable[str], port: int) -> frozenset[str]:
    """What may stand in Host: these names with the port, and without where it is HTTP's own."""
    named = frozenset(f"{name}:{port}" for name in names)
    return named | frozenset(names) if port == 80 else named


def rejection_reason(scope: Scope, allowed: frozenset[str]) -> str:
    """Why a request or a WebSocket is turned away; empty where it is not."""
    headers = Headers(scope=scope)
    if headers.getlist("host") != [headers.get("host", "")] or headers["host"].lower() not in allowed:
        return "Host is no name of this page"
    origins = headers.getlist("origin")
    if scope["type"] == "websocket" and not origins:
        return "a WebSocket without Origin"
    if any(origin.lower() not in {f"http://{host}" for host in allowed} for origin in origins):
        return "Origin is another page"
    return ""


class AccessGuard:
    """ASGI middleware: rejects with 403 what ``rejection_reason`` names and adds ``HEADERS`` to every response."""

    def __init__(self, app: ASGIApp, *, allowed: frozenset[str]) -> None:
        self._app = app
        self._allowed = allowed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        why = rejection_reason(scope, self._allowed)
        if not why:
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "http":
            await PlainTextResponse(f"refused: {why}\n", 403)(scope, receive, _with_headers(send))
        else:  # closing before accepting is answered with 403
            await send({"type": "websocket.close", "code": 1008, "reason": why})


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message).update(HEADERS)
        await send(message)

    return sent
