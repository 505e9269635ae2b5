"""The processes of a run: each at its work, behind each that may be started anew a spare."""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from services.launch import table
from services.launch.child import LATER, NOW
from services.launch.children import Child
from services.launch.heartbeat import HUNG_S
from services.launch.orphans import Guard

WORLD_PATIENCE_S = 10.0
"""Plant and sensors are not started anew: a machine that is busy for a while shall not end the run."""

SPARE_S = 10.0
"""So long at most one spare has the processor to itself."""


class Crew:
    """``children`` are by name, in the order of their start; each started anew takes its former self's place."""

    def __init__(self, logs: Path, guard: Guard) -> None:
        self.children: dict[str, Child] = {}
        self._logs = logs
        self._guard = guard
        self._rows: dict[str, table.Process] = {}
        self._commands: dict[str, list[str]] = {}
        self._starts: dict[str, int] = {}
        self._spares: dict[str, Child] = {}
        self._without_spare: set[str] = set()
        self._spare_due_s = 0.0

    def start(self, row: table.Process, places: Mapping[str, str]) -> None:
        """The first of its name."""
        self._rows[row.name] = row
        self._commands[row.name] = table.command(row, places)
        self.children[row.name] = self._spawn(row.name, None)

    def restart(self, name: str, restore: bytes) -> None:
        """Another in the place of one that is dead: its spare, or where that is not ready yet one from nothing, which
        has the processor sooner.
        """
        self.children[name].close()
        child = self._spares.pop(name, None)
        if child is not None:
            child.listen()
            if not child.ready or child.gone:
                child.kill()
                child.close()
                child = None
        self.children[name] = child or self._spawn(name, NOW)
        self.children[name].take_turn(restore)

    def restartable(self, name: str) -> bool:
        """Whether it may be started anew."""
        return self._rows[name].restartable

    def keep_spares(self, now_s: float) -> None:
        """One spare after the other, where one is missing. Who has lost one that did nothing gets no other."""
        for name, spare in tuple(self._spares.items()):
            spare.listen()
            if spare.gone:
                spare.kill()
                self._spares.pop(name).close()
                self._without_spare.add(name)
        if not all(spare.ready for spare in self._spares.values()) and now_s < self._spare_due_s:
            return
        rows = self._rows.values()
        # The router's is soon loaded, and everyone hangs on it; then the controller's and the estimator's.
        for row in (*(row for row in rows if not row.needs), *(row for row in reversed(rows) if row.needs)):
            if row.restartable and row.name not in self._spares and row.name not in self._without_spare:
                self._spares[row.name] = self._spawn(row.name, LATER)
                self._spare_due_s = now_s + SPARE_S
                return

    def dismiss_spares(self) -> None:
        """They have nothing to finish."""
        for spare in self._spares.values():
            spare.kill()
            spare.close()
        self._spares.clear()
        self._without_spare.update(self._rows)

    def listen(self, timeout_s: float, stop: Callable[[], bool]) -> None:
        """Take pulses for so long, or until one has ended."""
        until = time.monotonic() + timeout_s
        while (left_s := until - time.monotonic()) > 0 and not stop():
            pulses = {child.pulse: child for child in self._living()}
            for pulse in select.select(list(pulses), [], [], left_s)[0]:
                pulses[pulse].listen()
            if any(child.gone for child in pulses.values()):
                return

    def _living(self) -> Iterable[Child]:
        return (child for child in self.children.values() if child.pulse >= 0 and not child.gone)

    def _spawn(self, name: str, turn: str | None) -> Child:
        count = self._starts[name] = self._starts.get(name, 0) + 1
        return Child(
            name,
            self._commands[name],
            log=self._logs / (f"{name}.log" if count == 1 else f"{name}.{count}.log"),
            guard=self._guard,
            turn=turn,
            patience_s=HUNG_S if self._rows[name].restartable else WORLD_PATIENCE_S,
        )
