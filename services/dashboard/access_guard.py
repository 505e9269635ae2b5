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

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
TOKEN_BYTES = 24

SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'{scripts}; style-src 'self' 'unsafe-inline'; img-src data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""Inline styles are allowed because plotly sets them; of inline scripts only those that are named by their hashes."""


def headers(inline_scripts: Iterable[str]) -> list[tuple[str, str]]:
    """Return the headers of every response; a page that this page opens may have ``inline_scripts``."""
    hashes = (base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in inline_scripts)
    return [
        ("content-security-policy", SECURITY_POLICY.format(scripts="".join(f" 'sha256-{one}'" for one in hashes))),
        ("x-content-type-options", "nosniff"),
        ("x-frame-options", "DENY"),
        ("referrer-policy", "no-referrer"),
        ("cross-origin-resource-policy", "same-origin"),
        ("cache-control", "no-store"),
    ]


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
    """ASGI middleware: rejects with 403 what ``rejection_reason`` names; ``allowed`` are the accepted Host headers."""

    def __init__(self, app: ASGIApp, *, allowed: frozenset[str]) -> None:
        self._app = app
        self._allowed = allowed

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a connection (ASGI)."""
        why = rejection_reason(scope, self._allowed) if scope["type"] in ("http", "websocket") else ""
        if not why:
            await self._app(scope, receive, send)
        elif scope["type"] == "http":
            await PlainTextResponse(f"refused: {why}\n", 403)(scope, receive, send)
        else:  # the server answers a close before the accept with 403
            await send({"type": "websocket.close", "code": 1008, "reason": why})
