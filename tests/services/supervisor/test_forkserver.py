"""Forked children behave as spawned ones: logs, exit codes, and none outlives the supervisor."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from services.bus.options import BusOptions
from services.processes import plant
from services.supervisor import forkserver, orphan_cleanup
from services.supervisor.child_processes import ChildProcesses
from services.supervisor.entry_point import write_config
from services.supervisor.forkserver import ForkServer
from services.supervisor.managed_process import ManagedProcess, Program
from services.supervisor.parent_death import OrphanCleanup
from services.supervisor.process_table import ProcessRow
from tests.waiting import until

PATIENCE_S = 60.0

QUICK = """
import os, re, signal, sys, time, types
import msgspec
from services.supervisor import forkserver
from services.runtime.supervisor_link import SUPERVISOR_LINK

class Config(msgspec.Struct):
    task: str
    code: int

def main(config):
    '''In the place of a node: what its config asks for.'''
    print(config.task, flush=True)
    SUPERVISOR_LINK.restored_state()
    SUPERVISOR_LINK.beat(time.monotonic_ns() // 1000)
    match config.task:
        case "exits":
            return config.code
        case "raises":
            raise RuntimeError("as it was told to")
        case "sleeps":
            time.sleep(600)
        case "holds the GIL":
            re.match("(a+)+$", "a" * 60 + "b")

sys.modules["quick"] = types.SimpleNamespace(Config=Config, main=main)
forkserver.load = lambda scenario: None
forkserver.main()
"""
"""Program of a fork server that loads nothing, with children that do little."""


class Quick(msgspec.Struct):
    """Config of these children."""

    task: str
    code: int = 0


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forkserver, "PROGRAM", ("-c", QUICK))


@pytest.fixture
def watch() -> Iterator[OrphanCleanup]:
    watch = OrphanCleanup()
    yield watch
    watch.close()


@pytest.fixture
def server(tmp_path: Path, watch: OrphanCleanup) -> Iterator[ForkServer]:
    server = ForkServer(tmp_path / "scenario.toml", tmp_path / "forkserver.log", watch)
    until(server.is_loaded)
    yield server
    server.close()


def forked(server: ForkServer, log: Path, watch: OrphanCleanup, name: str, task: str, code: int = 0) -> ManagedProcess:
    config = log.with_name(f"{name}.json")
    write_config(config, Quick(task, code))
    return ManagedProcess(Program(name, "quick", config, log), cleanup=watch, forks=server)


def stat(pid: int) -> list[str]:
    """Return state, parent, group, session, ..."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


@pytest.mark.parametrize(("task", "code"), [("exits", 0), ("exits", 7), ("raises", 1)])
def test_a_forked_child_has_its_own_exit_code_and_log(
    server: ForkServer, watch: OrphanCleanup, tmp_path: Path, task: str, code: int
) -> None:
    child = forked(server, tmp_path / "log", watch, "plant", task, code)
    assert child.wait_or_kill(PATIENCE_S)
    child.close()
    assert child.exit_code() == code
    said = child.last_lines()
    assert said[0] == task
    assert (said[-1] == "RuntimeError: as it was told to") == (task == "raises")


def test_a_forked_child_belongs_to_the_supervisor_and_has_its_own_session(
    server: ForkServer, watch: OrphanCleanup, tmp_path: Path
) -> None:
    child = forked(server, tmp_path / "log", watch, "plant", "sleeps")
    until(lambda: bool(child.last_lines()))
    _, parent, _, session, *_ = stat(child.pid)
    assert (int(parent), int(session)) == (os.getpid(), child.pid)
    assert Path(f"/proc/{child.pid}/comm").read_text() == "ltv-plant\n"
    child.kill()
    child.close()
    assert child.exit_code() == -signal.SIGKILL


def rejected(tmp_path: Path) -> Program:
    """Program that ends with one line on stderr, forked or spawned."""
    config = tmp_path / "plant.json"
    write_config(config, plant.Config(bus=BusOptions(), scenario="hoover"))
    return Program("plant", plant.__name__, config, tmp_path / "log")


def test_without_a_fork_server_a_child_is_spawned_and_bad_input_is_one_line(
    watch: OrphanCleanup, tmp_path: Path
) -> None:
    child = ManagedProcess(rejected(tmp_path), cleanup=watch, forks=None)
    assert child.wait_or_kill(PATIENCE_S)
    child.close()
    assert child.exit_code() == 2
    (line,) = (tmp_path / "log").read_text().splitlines()
    assert line.startswith('ltv-mpc: scenario "hoover": no shipped name')


def test_one_that_is_forked_too_late_ends_and_another_has_its_place(
    server: ForkServer, watch: OrphanCleanup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fork server's reply comes after the timeout."""
    until(server.is_loaded)
    monkeypatch.setattr(server, "_has_reply", lambda _within_s: False)
    before = set(own_children())
    child = ManagedProcess(rejected(tmp_path), cleanup=watch, forks=server)
    assert child.wait_or_kill(PATIENCE_S)
    child.close()
    assert child.exit_code() == 2
    until(lambda: set(own_children()) - before <= {child.pid})


def own_children() -> Iterator[int]:
    """Yield the pids of this process's living children."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, parent, *_ = stat(int(folder.name))
        except OSError:
            continue
        if int(parent) == os.getpid() and state != "Z":
            yield int(folder.name)


def test_heartbeats_arrive_and_the_end_is_noticed(server: ForkServer, watch: OrphanCleanup, tmp_path: Path) -> None:
    child = forked(server, tmp_path / "log", watch, "plant", "exits")

    def ended() -> bool:
        child.read_heartbeats()
        return child.pipe_closed

    until(ended)
    assert child.hang_detector.last_s is not None
    child.wait_or_kill(PATIENCE_S)
    child.close()


def test_one_after_the_other_is_forked_and_nothing_is_used_up(
    server: ForkServer, watch: OrphanCleanup, tmp_path: Path
) -> None:
    children = [forked(server, tmp_path / f"{k}.log", watch, "plant", "sleeps") for k in range(3)]
    until(lambda: all(child.last_lines() for child in children))
    assert len({child.pid for child in children}) == 3
    for child in children:
        child.kill()
        child.close()


@pytest.fixture
def crew(tmp_path: Path, watch: OrphanCleanup) -> Iterator[ChildProcesses]:
    crew = ChildProcesses(tmp_path / "scenario.toml", tmp_path, watch)
    crew.start_fork_server()
    yield crew
    for child in crew.by_name.values():
        child.kill()
        child.close()
    crew.close()


def test_a_dead_fork_server_kills_no_child_and_is_replaced(crew: ChildProcesses, tmp_path: Path) -> None:
    first = crew.forks
    assert first is not None
    until(first.is_loaded)
    for name in ("plant", "sensors"):
        crew.start(ProcessRow(name, "quick", True, ()), Quick("sleeps"))
    until(lambda: all(child.last_lines() for child in crew.by_name.values()))
    os.kill(first.pid, signal.SIGKILL)
    until(lambda: first.exit_code() is not None)
    assert (
        first.fork("quick", tmp_path / "plant.json", tmp_path / "log", 0, 1) is None
    )  # whoever is to begin now is spawned
    crew.replace_dead_fork_server()
    second = crew.forks
    assert second is not None
    assert second is not first
    until(second.is_loaded)
    assert [child.exit_code() for child in crew.by_name.values()] == [None, None]
    crew.by_name["plant"].kill()
    crew.restart("plant", b"")
    until(lambda: bool(crew.by_name["plant"].last_lines()))
    assert stat(crew.by_name["plant"].pid)[1] == str(os.getpid())


SUPERVISOR = f"""
import sys, time
from pathlib import Path
import msgspec
from services.supervisor import forkserver
from services.supervisor.managed_process import ManagedProcess, Program
from services.supervisor.parent_death import OrphanCleanup
forkserver.PROGRAM = ("-c", {QUICK!r})
folder, cleanup = Path(sys.argv[1]), OrphanCleanup()
server = forkserver.ForkServer(folder / "scenario.toml", folder / "forkserver.log", cleanup)
while not server.is_loaded():
    time.sleep(0.01)
print(server.pid, flush=True)
for k, (name, task) in enumerate([("plant", "sleeps"), ("controller", "holds the GIL"), ("recorder", "holds the GIL")]):
    config = folder / f"{{name}}.json"
    config.write_bytes(msgspec.json.encode({{"task": task, "code": 0}}))
    child = ManagedProcess(Program(name, "quick", config, folder / f"{{k}}.log"), cleanup=cleanup, forks=server)
    while not child.last_lines() or child.hang_detector.last_s is None:
        child.read_heartbeats()
    print(child.pid, flush=True)
time.sleep(600)
"""


def test_a_killed_supervisor_leaves_no_fork_even_if_stopped_or_holding_the_gil(tmp_path: Path) -> None:
    supervisor = subprocess.Popen(
        [sys.executable, "-P", "-c", SUPERVISOR, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert supervisor.stdout is not None
    pids = [int(supervisor.stdout.readline()) for _ in range(4)]
    os.kill(pids[1], signal.SIGSTOP)
    assert all(orphan_cleanup.start_ticks(pid) is not None for pid in pids)
    try:
        supervisor.kill()
        supervisor.wait()
        until(lambda: all(orphan_cleanup.start_ticks(pid) is None for pid in pids))
    finally:
        supervisor.stdout.close()
        for pid in pids:
            if orphan_cleanup.start_ticks(pid) is not None:
                os.kill(pid, signal.SIGKILL)
