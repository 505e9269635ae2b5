"""Update stream of the live page: to each browser, ten times a second, what is new since its last text.

    whole   the complete state, for a browser that has just connected or shows another run
    tick    the rows, event marks and status since the last text

``tables`` hold the newest state and are sent whole each time. ``rows`` are appended to the table of the same name, or
replace it if ``replaced`` names it. A slow browser gets fewer texts, each with more in it, and delays no other one.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque

import msgspec

from services.dashboard.bus_feed import BusFeed
from services.reporting.plots.table import Columns

PERIOD_S = 0.1
MAX_READERS = 32
"""Largest number of readers without the token. Those with it have a place at any time."""

MAX_WAITING = 100


class Reader:
    """Browser: what it has received, and what it may do."""

    def __init__(self) -> None:
        self.run = -1
        """Number of the run of which it has data."""
        self.sent: dict[str, tuple[int, int]] = {}
        """Generation and number of rows that it has, by table."""
        self.marks = 0
        """Number of event marks that it has."""
        self.has_report = False
        """True once the browser has said so."""
        self.has_token = False
        """True once a command of the browser had the token."""
        self.evicted = asyncio.Event()


class Stream:
    """Updates of a bus feed for all browsers."""

    def __init__(self, feed: BusFeed) -> None:
        self._feed = feed
        self.readers: set[Reader] = set()
        self._waiting: deque[Reader] = deque()
        self._current: dict[str, msgspec.Raw] = {}  # newest state, encoded once for all; empty until one needs it

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
        """Update the feed every ``PERIOD_S`` until cancelled."""
        while True:
            self._feed.update()
            self._current = {}
            await asyncio.sleep(PERIOD_S)

    def next_text(self, reader: Reader) -> str:
        """Return what is new for a reader since its last text."""
        feed, collector = self._feed, self._feed.collector
        kind = "tick"
        if feed.run != reader.run:
            kind, reader.run, reader.sent, reader.marks = "whole", feed.run, {}, 0
        rows, replaced = dict[str, Columns](), list[str]()
        for name, table in collector.tables.items():
            generation, count = reader.sent.get(name, (table.generation, 0))
            if table.generation != generation:
                replaced.append(name)
                count = 0
            if len(table) > count or name not in reader.sent:
                rows[name] = table.since(count)
            reader.sent[name] = table.generation, len(table)
        marks = collector.marks.marks[reader.marks :]
        reader.marks += len(marks)
        if not self._current:
            current = {"tables": collector.current_tables(), "values": collector.values, "status": feed.status()}
            self._current = {name: msgspec.Raw(msgspec.json.encode(part)) for name, part in current.items()}
        news = {"kind": kind, "rows": rows, "replaced": replaced, "marks": marks}
        return msgspec.json.encode(news | self._current).decode()
