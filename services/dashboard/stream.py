"""The page's stream: one text ten times a second, encoded once, whoever many read it.

    whole   everything there is: to who has just come, and to who could not keep up
    tick    the rows, marks and words since the last one

``tables`` are of the moment, whole each time; ``rows`` go behind those of the same name, or take their place where
``replaced`` names them. A reader that is ``LATE`` texts behind gets none of them but the whole, once it reads again:
nobody's slowness fills the memory or holds the others up.
"""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec

from services.dashboard.bus_feed import Ears
from services.reporting.plots.table import Columns

PERIOD_S = 0.1
LATE = 20
MOST_READERS = 32


class Reader:
    """One browser's queue."""

    def __init__(self) -> None:
        self._texts: asyncio.Queue[str] = asyncio.Queue(LATE)
        self.behind = True
        """It has to be given the whole."""

    @property
    def idle(self) -> bool:
        """It has taken all there was for it."""
        return self._texts.empty()

    def give(self, text: str) -> None:
        """Leave it here; of one that is too late, forget all."""
        if self._texts.full():
            self.behind = True
            while not self._texts.empty():
                self._texts.get_nowait()
            return
        self._texts.put_nowait(text)

    async def take(self) -> str:
        """The next one."""
        return await self._texts.get()


class Stream:
    """Looks at what was heard, and gives it to all readers."""

    def __init__(self, ears: Ears) -> None:
        self._ears = ears
        self.readers: set[Reader] = set()
        self._run = -1
        self._sent: dict[str, tuple[int, int]] = {}  # by table: generation, rows
        self._marks = 0

    async def go(self) -> None:
        """Until cancelled."""
        while True:
            self.tick()
            await asyncio.sleep(PERIOD_S)

    def tick(self) -> None:
        """Look, and give everyone what is new."""
        self._ears.look()
        new = self._new()
        if not self.readers:
            return
        tick = _text("tick", new)
        whole = ""
        for reader in self.readers:
            if not reader.behind:
                reader.give(tick)
            elif reader.idle:
                whole = whole or _text("whole", self._whole())
                reader.behind = False
                reader.give(whole)

    def _new(self) -> dict[str, Any]:
        collector = self._ears.collector
        if self._ears.run != self._run:  # everything that readers have is of another run
            self._run = self._ears.run
            self._sent, self._marks = {}, 0
            for reader in self.readers:
                reader.behind = True
        rows: dict[str, Columns] = {}
        replaced = []
        for name, table in collector.tables.items():
            generation, count = self._sent.get(name, (0, 0))
            if table.generation != generation:
                replaced.append(name)
                count = 0
            if len(table) > count:
                rows[name] = table.since(count) if self.readers else {}
            self._sent[name] = (table.generation, len(table))
        marks = collector.marks.marks[self._marks :]
        self._marks = len(collector.marks.marks)
        return {"rows": rows, "replaced": replaced, "marks": marks, **self._of_now()} if self.readers else {}

    def _whole(self) -> dict[str, Any]:
        collector = self._ears.collector
        rows = {name: table.since(0) for name, table in collector.tables.items()}
        return {"rows": rows, "replaced": [], "marks": collector.marks.marks, **self._of_now()}

    def _of_now(self) -> dict[str, Any]:
        collector = self._ears.collector
        return {"tables": collector.now(), "values": collector.values, "moment": self._ears.moment()}


def _text(kind: str, content: dict[str, Any]) -> str:
    return msgspec.json.encode({"kind": kind, **content}).decode()
