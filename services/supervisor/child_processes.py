"""Child processes of a run, by name, and the fork server that starts them."""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from services.runtime.stopping import DONE
from services.supervisor.entry_point import write_config
from services.supervisor.forkserver import ForkServer
from services.supervisor.managed_process import ManagedProcess
from services.supervisor.process_table import ProcessRow

ORDERLY_S = 2.0  # for one node, after a complete run
ORDERLY_RECORDER_S = 10.0  # a slow disk
HASTY_S = 0.7  # for all nodes together, after Ctrl-C or a failure; with the two below, at most 2 s for the whole stop
HASTY_RECORDER_S = 0.9
HASTY_ROUTER_S = 0.2


class ChildProcesses:
    """Child processes of a run."""

    def __init__(self, scenario: Path, logs: Path, group: int) -> None:
        """``group`` is the process group of all processes."""
        self.by_name: dict[str, ManagedProcess] = {}
        """Child processes in the order of their start."""
        self.forks = ForkServer(scenario, logs / "forkserver.log", group)
        self._logs = logs

    def start(self, row: ProcessRow, config: msgspec.Struct) -> None:
        """Write the config of a process and start it."""
        path = self._logs / f"{row.name}.json"
        write_config(path, config)
        child = ManagedProcess(self.forks, row, path)
        child.start()
        self.by_name[row.name] = child

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
                    killed.append(child.row.name)
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
        running = [child for child in self.by_name.values() if child.exit_code() is None]
        while (left_s := until - time.monotonic()) > 0 and not stop():
            select.select([fd for child in running for fd in child.descriptors], [], [], left_s)
            for child in running:
                child.read_heartbeats()
            if any(child.exit_code() is not None for child in running):
                return
