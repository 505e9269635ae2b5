"""The processes of a run, each at its work; all are forked from one that has loaded what they need."""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec

from services.supervisor import forkserver, process_table
from services.supervisor.entry_point import write_config
from services.supervisor.forkserver import ForkServer
from services.supervisor.hang_detector import HANG_TIMEOUT_S
from services.supervisor.managed_process import ManagedProcess
from services.supervisor.parent_death import OrphanCleanup

WORLD_PATIENCE_S = 10.0
"""Plant and sensors are not started anew: a machine that is busy for a while shall not end the run."""


class ChildProcesses:
    """``children`` are by name, in the order of their start; each started anew takes its former self's place."""

    def __init__(self, scenario: Path, logs: Path, guard: OrphanCleanup) -> None:
        self.children: dict[str, ManagedProcess] = {}
        self.forks: ForkServer | None = None
        """None where the system has no such thing, and everyone is spawned."""
        self._scenario = scenario
        self._logs = logs
        self._guard = guard
        self._rows: dict[str, process_table.ProcessRow] = {}
        self._starts: dict[str, int] = {}

    def load(self) -> None:
        """Begin to load what everyone needs."""
        if forkserver.possible():
            self.forks = ForkServer(self._scenario, self._log("forkserver"), self._guard)

    def keep_loaded(self) -> None:
        """Another fork server in the place of one that is dead; until it has loaded, whoever is to begin is spawned."""
        if self.forks is not None and self.forks.exit_code() is not None:
            self.forks.close()
            self.load()

    def start(self, row: process_table.ProcessRow, config: msgspec.Struct) -> None:
        """The first of its name."""
        self._rows[row.name] = row
        write_config(self._config(row.name), config)
        self.children[row.name] = self._begin(row.name, b"")

    def restart(self, name: str, state: bytes) -> None:
        """Another in the place of one that is dead; ``state``: the state to go on from, as it travels, or nothing."""
        self.children[name].close()
        self.children[name] = self._begin(name, state)

    def restartable(self, name: str) -> bool:
        """Whether it may be started anew."""
        return self._rows[name].restartable

    def close(self) -> None:
        """Nobody begins any more."""
        if self.forks is not None:
            self.forks.close()
            self.forks = None

    def listen(self, timeout_s: float, stop: Callable[[], bool]) -> None:
        """Take pulses for so long, or until one has ended."""
        until = time.monotonic() + timeout_s
        while (left_s := until - time.monotonic()) > 0 and not stop():
            pulses = {child.pulse: child for child in self._living()}
            for pulse in select.select(list(pulses), [], [], left_s)[0]:
                pulses[pulse].listen()
            if any(child.gone for child in pulses.values()):
                return

    def _living(self) -> Iterable[ManagedProcess]:
        return (child for child in self.children.values() if child.pulse >= 0 and not child.gone)

    def _begin(self, name: str, state: bytes) -> ManagedProcess:
        return ManagedProcess(
            name,
            self._rows[name].module,
            self._config(name),
            log=self._log(name),
            guard=self._guard,
            forks=self.forks,
            state=state,
            patience_s=HANG_TIMEOUT_S if self._rows[name].restartable else WORLD_PATIENCE_S,
        )

    def _config(self, name: str) -> Path:
        return self._logs / f"{name}.json"

    def _log(self, name: str) -> Path:
        count = self._starts[name] = self._starts.get(name, 0) + 1
        return self._logs / (f"{name}.log" if count == 1 else f"{name}.{count}.log")
