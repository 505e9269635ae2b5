"""Update stream of the live page: one text ten times a second, encoded once for all browsers.

    whole   the complete state, for a browser that has just connected or has fallen behind
    tick    the rows, event marks and status since the last text

``tables`` hold the newest state and are sent whole each time. ``rows`` are appended to the table of the same name, or
replace it if ``replaced`` names it. A browser that falls ``MAX_BACKLOG`` texts behind loses them and receives a whole
text when it reads again, so that a slow browser neither fills the memory nor delays the others.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Mapping
from typing import Any

import msgspec

from services.dashboard.bus_feed import BusFeed
from services.reporting.plots.table import Columns

PERIOD_S = 0.1
MAX_BACKLOG = 20
MAX_READERS = 32
"""Largest number of readers without the token. Those with it have a place at any time."""

MAX_WAITING = 100


class Reader(asyncio.Queue[str]):
    """Queue of texts for one browser."""

    def __init__(self) -> None:
        super().__init__(MAX_BACKLOG)
        self.behind = True
        """True if the next text must be the complete state."""
        self.has_report = False
        """True once the browser has said so."""
        self.has_token = False
        """True once a command of the browser had the token."""
        self.evicted = asyncio.Event()

    def send(self, text: str) -> None:
        """Queue a text; if the queue is full, drop all texts and mark the browser as behind."""
        if not self.full():
            self.put_nowait(text)
            return
        self.behind = True
        while not self.empty():
            self.get_nowait()


class Stream:
    """Sender of the updates of a bus feed to all browsers."""

    def __init__(self, feed: BusFeed) -> None:
        self._feed = feed
        self.readers: set[Reader] = set()
        self._waiting: deque[Reader] = deque()
        self._run = -1
        self._sent: dict[str, tuple[int, int]] = {}  # by table: generation, rows
        self._marks = 0

    def admit(self, reader: Reader) -> bool:
        """Add a reader if it has the token or a place is left. Else it waits, in place of the first of too many."""
        if reader.has_token or sum(not one.has_token for one in self.readers) < MAX_READERS:
            self.readers.add(reader)
            return True
        if len(self._waiting) >= MAX_WAITING:
            self._waiting.popleft().evicted.set()
        self._waiting.append(reader)
        return False

    def leave(self, reader: Reader) -> None:
        """Remove a reader."""
        self.readers.discard(reader)
        with contextlib.suppress(ValueError):
            self._waiting.remove(reader)

    async def run(self) -> None:
        """Send updates every ``PERIOD_S`` until cancelled."""
        while True:
            self.tick()
            await asyncio.sleep(PERIOD_S)

    def tick(self) -> None:
        """Update the feed and queue the new data for every browser."""
        self._feed.update()
        collector = self._feed.collector
        if self._feed.run != self._run:  # the browsers hold the data of another run
            self._run, self._sent, self._marks = self._feed.run, {}, 0
            for reader in self.readers:
                reader.behind = True
        tick = _text("tick", self._since(self._sent, self._marks)) if self.readers else ""
        self._sent = {name: (table.generation, len(table)) for name, table in collector.tables.items()}
        self._marks = len(collector.marks.marks)
        whole = ""
        for reader in self.readers:
            if not reader.behind:
                reader.send(tick)
            elif reader.empty():  # it has taken all texts
                whole = whole or _text("whole", self._since({}, 0))
                reader.behind = False
                reader.send(whole)

    def _since(self, sent: Mapping[str, tuple[int, int]], marks: int) -> dict[str, Any]:
        """Return what is new since tables of these generations and rows, and so many marks, were sent."""
        collector, rows, replaced = self._feed.collector, dict[str, Columns](), list[str]()
        for name, table in collector.tables.items():
            generation, count = sent.get(name, (table.generation, 0))
            if table.generation != generation:
                replaced.append(name)
                count = 0
            if len(table) > count or name not in sent:
                rows[name] = table.since(count)
        current = {"tables": collector.current_tables(), "values": collector.values, "status": self._feed.status()}
        return {"rows": rows, "replaced": replaced, "marks": collector.marks.marks[marks:], **current}


def _text(kind: str, content: dict[str, Any]) -> str:
    return msgspec.json.encode({"kind": kind, **content}).decode()
