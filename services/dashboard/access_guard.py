"""Access control of the live page. It is needed because any web page in the same browser can send requests to it.

Host     must be a name of this page. Otherwise a foreign name that resolves to this machine (DNS rebinding) could
         read the page as its own.
Origin   must be this page if the browser sends one. Every WebSocket needs it, because browsers allow any page to open
         a WebSocket to any host.
token    192 random bits in the printed URL after the #, which browsers do not send. Commands carry the token; reading
         needs none.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets
from collections.abc import Iterable

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
TOKEN_BYTES = 24

SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'{scripts}; style-src 'self' 'unsafe-inline'; img-src data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Inline styles are allowed because plotly sets them; of inline scripts only those that are named by their hashes."""

HEADERS = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
"""Headers of every response, beside the security policy."""


class Token:
    """Secret token, new at each start of the page's process."""

    def __init__(self) -> None:
        self.text = secrets.token_urlsafe(TOKEN_BYTES)

    def matches(self, text: str) -> bool:
        """Return True if ``text`` is the token; the comparison takes constant time."""
        return hmac.compare_digest(self.text.encode(), text.encode(errors="replace"))


def hosts(names: Iterable[str], port: int) -> frozenset[str]:
    """Return the accepted values of the Host header: each name with the port, and without it if the port is 80."""
    named = frozenset(f"{name}:{port}" for name in names)
    return named | frozenset(names) if port == 80 else named


def rejection_reason(scope: Scope, allowed: frozenset[str]) -> str:
    """Return why a request or a WebSocket is rejected; empty if it is accepted."""
    headers = Headers(scope=scope)
    if headers.getlist("host") != [headers.get("host", "")] or headers["host"].lower() not in allowed:
        return "Host header is not a name of this page"
    origins = headers.getlist("origin")
    if scope["type"] == "websocket" and not origins:
        return "WebSocket without an Origin header"
    if any(origin.lower() not in {f"http://{host}" for host in allowed} for origin in origins):
        return "Origin header names another page"
    return ""


class AccessGuard:
    """ASGI middleware: rejects with 403 what ``rejection_reason`` names and adds headers to every response."""

    def __init__(self, app: ASGIApp, *, allowed: frozenset[str], inline_scripts: Iterable[str] = ()) -> None:
        """Accept the Host headers ``allowed``; a page that this page opens may have ``inline_scripts``."""
        self._app = app
        self._allowed = allowed
        hashes = "".join(f" 'sha256-{_sha256(script)}'" for script in inline_scripts)
        self._headers = {**HEADERS, "content-security-policy": SECURITY_POLICY.format(scripts=hashes)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a connection (ASGI)."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        why = rejection_reason(scope, self._allowed)
        if not why:
            await self._app(scope, receive, self._with_headers(send))
        elif scope["type"] == "http":
            await PlainTextResponse(f"refused: {why}\n", 403)(scope, receive, self._with_headers(send))
        else:  # the server answers a close before the accept with 403
            await send({"type": "websocket.close", "code": 1008, "reason": why})

    def _with_headers(self, send: Send) -> Send:
        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(self._headers)
            await send(message)

        return sent


def _sha256(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
