"""Child processes of a run, by name, and the fork server that starts them."""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec

from services.runtime.stopping import DONE
from services.supervisor import process_table
from services.supervisor.entry_point import write_config
from services.supervisor.forkserver import ForkServer
from services.supervisor.hang_detector import HANG_TIMEOUT_S
from services.supervisor.managed_process import ManagedProcess

ORDERLY_S = 2.0  # for one node, after a complete run
ORDERLY_RECORDER_S = 10.0  # a slow disk
HASTY_S = 0.7  # for all nodes together, after Ctrl-C or a failure; with the two below, at most 2 s for the whole stop
HASTY_RECORDER_S = 0.9
HASTY_ROUTER_S = 0.2

SIMULATION_HANG_TIMEOUT_S = 10.0
"""Hang timeout of plant and sensors. They are not restarted, so a busy machine must not end the run too early."""


class ChildProcesses:
    """Current child processes. A restarted process replaces the failed one under the same name."""

    def __init__(self, scenario: Path, logs: Path, group: int) -> None:
        """``group`` is the process group of all processes."""
        self.by_name: dict[str, ManagedProcess] = {}
        """Child processes in the order of their start."""
        self.forks = ForkServer(scenario, logs / "forkserver.log", group)
        self._logs = logs
        self._rows: dict[str, process_table.ProcessRow] = {}
        self._starts: dict[str, int] = {}

    def start(self, row: process_table.ProcessRow, config: msgspec.Struct) -> None:
        """Write the config of a process and start it."""
        self._rows[row.name] = row
        write_config(self._config(row.name), config)
        self.by_name[row.name] = self._start(row.name, b"")

    def restart(self, name: str, state: bytes) -> None:
        """Start a new process in place of a dead one. ``state`` is the encoded state to continue from, or empty."""
        self.by_name[name].close()
        self.by_name[name] = self._start(name, state)

    def restartable(self, name: str) -> bool:
        """Return True if the process table allows a restart of this process."""
        return self._rows[name].restartable

    @property
    def run_complete(self) -> bool:
        """True once the plant has done its last step."""
        plant = self.by_name.get("plant")
        return plant is not None and plant.exit_code() == DONE

    def stop(self, *, in_order: bool, close_session: Callable[[], None]) -> list[str]:
        """Stop all processes: nodes, then the recorder, which records their last messages, then the router.

        ``in_order``: stop one node after the other, so that each receives all messages of the one before; otherwise all
        at once. ``close_session`` closes the supervisor's own session, before the router stops. Return the names of
        those that had to be killed because they had not exited in time.
        """
        self.forks.close()
        nodes = [child for name, child in self.by_name.items() if name not in ("router", "recorder")]
        if not in_order:
            for child in nodes:
                child.terminate()
        killed, until = [], time.monotonic() + HASTY_S

        def stop(child: ManagedProcess | None, timeout_s: float) -> None:
            if child is not None:
                child.terminate()
                if not child.wait_or_kill(timeout_s):
                    killed.append(child.name)
                child.close()

        for child in nodes:
            stop(child, ORDERLY_S if in_order else until - time.monotonic())
        stop(self.by_name.get("recorder"), ORDERLY_RECORDER_S if in_order else HASTY_RECORDER_S)
        close_session()
        stop(self.by_name.get("router"), ORDERLY_S if in_order else HASTY_ROUTER_S)
        return killed

    def wait(self, timeout_s: float, stop: Callable[[], bool]) -> None:
        """Read heartbeats for ``timeout_s``. Return earlier if a child has ended or a stop is requested."""
        until = time.monotonic() + timeout_s
        while (left_s := until - time.monotonic()) > 0 and not stop():
            by_fd = {child.heartbeat_fd: child for child in self._running()}
            for fd in select.select(list(by_fd), [], [], left_s)[0]:
                by_fd[fd].read_heartbeats()
            if any(child.pipe_closed for child in by_fd.values()):
                return

    def _running(self) -> Iterable[ManagedProcess]:
        return (child for child in self.by_name.values() if child.heartbeat_fd >= 0 and not child.pipe_closed)

    def _start(self, name: str, state: bytes) -> ManagedProcess:
        row = self._rows[name]
        return ManagedProcess(
            self.forks,
            row.module,
            self._config(name),
            self._log(name),
            state=state,
            hang_timeout_s=HANG_TIMEOUT_S if row.restartable else SIMULATION_HANG_TIMEOUT_S,
        )

    def _config(self, name: str) -> Path:
        return self._logs / f"{name}.json"

    def _log(self, name: str) -> Path:
        count = self._starts[name] = self._starts.get(name, 0) + 1
        return self._logs / (f"{name}.log" if count == 1 else f"{name}.{count}.log")
