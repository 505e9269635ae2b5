"""HTTP connection of the page's server, which ends when it is idle, so that nobody can occupy all sockets.

A connection ends after ``IDLE_S`` in which it made no whole request and took no more of an answer. The one above
``MAX_SOCKETS`` takes the place of the oldest, of those without a request first. What became a WebSocket is not counted
idle here: the server's pings end it.
"""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

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
