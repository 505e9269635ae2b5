"""Forked children have logs and exit codes, none outlives the supervisor, and a fork server that fails is replaced."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from services.supervisor import forkserver
from services.supervisor.child_processes import ChildProcesses
from services.supervisor.entry_point import write_config
from services.supervisor.forkserver import ForkServer
from services.supervisor.managed_process import ManagedProcess
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
forkserver.load = lambda scenario: iter(())
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
def group() -> Iterator[int]:
    cleanup = OrphanCleanup()
    yield cleanup.group
    cleanup.close()


@pytest.fixture
def server(tmp_path: Path, group: int) -> Iterator[ForkServer]:
    server = ForkServer(tmp_path / "scenario.toml", tmp_path / "forkserver.log", group)
    server.load()
    until(server.is_loaded)
    yield server
    server.close()


def forked(server: ForkServer, log: Path, name: str, task: str, code: int = 0) -> ManagedProcess:
    config = log.with_name(f"{name}.json")
    write_config(config, Quick(task, code))
    return ManagedProcess(server, "quick", config, log)


def stat(pid: int) -> list[str]:
    """Return state, parent, group, session, ..."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


@pytest.mark.parametrize(("task", "code"), [("exits", 0), ("exits", 7), ("raises", 1)])
def test_a_forked_child_has_its_own_exit_code_and_log(server: ForkServer, tmp_path: Path, task: str, code: int) -> None:
    child = forked(server, tmp_path / "log", "plant", task, code)
    assert child.wait_or_kill(PATIENCE_S)
    child.close()
    assert child.exit_code() == code
    said = child.last_lines()
    assert said[0] == task
    assert (said[-1] == "RuntimeError: as it was told to") == (task == "raises")


def test_a_forked_child_belongs_to_the_supervisor_and_its_group_is_that_of_the_cleanup(
    server: ForkServer, tmp_path: Path, group: int
) -> None:
    child = forked(server, tmp_path / "log", "plant", "sleeps")
    until(lambda: bool(child.last_lines()))
    _, parent, its_group, *_ = stat(child.pid)
    assert (int(parent), int(its_group)) == (os.getpid(), group)
    assert Path(f"/proc/{child.pid}/comm").read_text() == "ltv-plant\n"
    child.kill()
    child.close()
    assert child.exit_code() == -signal.SIGKILL


def test_a_stopped_fork_server_is_replaced_and_what_it_forks_too_late_ends(server: ForkServer, tmp_path: Path) -> None:
    """The other one forks before it has loaded."""
    first, before = server.pid, set(own_children())
    os.kill(first, signal.SIGSTOP)
    child = forked(server, tmp_path / "log", "plant", "exits", 7)
    assert server.pid != first
    assert child.wait_or_kill(PATIENCE_S)
    child.close()
    assert child.exit_code() == 7
    until(lambda: set(own_children()) <= (before - {first}) | {server.pid})


def test_a_stop_request_ends_the_wait_for_the_fork_server(tmp_path: Path, group: int) -> None:
    server = ForkServer(tmp_path / "scenario.toml", tmp_path / "forkserver.log", group, stop=lambda: True)
    with pytest.raises(InterruptedError):
        forked(server, tmp_path / "log", "plant", "sleeps")
    server.close()


def own_children() -> Iterator[int]:
    """Yield the pids of this process's living children."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, parent, *_ = stat(int(folder.name))
        except OSError:
            continue
        if int(parent) == os.getpid() and state != "Z":
            yield int(folder.name)


def test_heartbeats_arrive_and_the_end_is_noticed(server: ForkServer, tmp_path: Path) -> None:
    child = forked(server, tmp_path / "log", "plant", "exits")

    def ended() -> bool:
        child.read_heartbeats()
        return child.pipe_closed

    until(ended)
    assert child.hang_detector.last_s is not None
    child.wait_or_kill(PATIENCE_S)
    child.close()


def test_one_after_the_other_is_forked_and_nothing_is_used_up(server: ForkServer, tmp_path: Path) -> None:
    children = [forked(server, tmp_path / f"{k}.log", "plant", "sleeps") for k in range(3)]
    until(lambda: all(child.last_lines() for child in children))
    assert len({child.pid for child in children}) == 3
    for child in children:
        child.kill()
        child.close()


@pytest.fixture
def crew(tmp_path: Path, group: int) -> Iterator[ChildProcesses]:
    crew = ChildProcesses(tmp_path / "scenario.toml", tmp_path, group)
    yield crew
    for child in crew.by_name.values():
        child.kill()
        child.close()
    crew.forks.close()


def test_a_dead_fork_server_kills_no_child_and_is_replaced(crew: ChildProcesses) -> None:
    first = crew.forks.pid
    for name in ("plant", "sensors"):
        crew.start(ProcessRow(name, "quick", True), Quick("sleeps"))
    until(lambda: all(child.last_lines() for child in crew.by_name.values()))
    os.kill(first, signal.SIGKILL)
    crew.by_name["plant"].kill()
    crew.restart("plant", b"")
    until(lambda: bool(crew.by_name["plant"].last_lines()))
    assert crew.forks.pid != first
    assert stat(crew.by_name["plant"].pid)[1] == str(os.getpid())
    os.kill(crew.forks.pid, signal.SIGKILL)
    until(lambda: crew.forks.exit_code() is not None)
    crew.forks.replace_if_dead()
    crew.forks.load()
    until(crew.forks.is_loaded)
    assert [child.exit_code() for child in crew.by_name.values()] == [None, None]


SUPERVISOR = f"""
import sys, time
from pathlib import Path
import msgspec
from services.supervisor import forkserver
from services.supervisor.managed_process import ManagedProcess
from services.supervisor.parent_death import OrphanCleanup
forkserver.PROGRAM = ("-c", {QUICK!r})
folder, cleanup = Path(sys.argv[1]), OrphanCleanup()
server = forkserver.ForkServer(folder / "scenario.toml", folder / "forkserver.log", cleanup.group)
print(cleanup.group, flush=True)
print(server.pid, flush=True)
for k, (name, task) in enumerate([("plant", "sleeps"), ("controller", "holds the GIL"), ("recorder", "holds the GIL")]):
    config = folder / f"{{name}}.json"
    config.write_bytes(msgspec.json.encode({{"task": task, "code": 0}}))
    child = ManagedProcess(server, "quick", config, folder / f"{{k}}.log")
    while not child.last_lines() or child.hang_detector.last_s is None:
        child.read_heartbeats()
    print(child.pid, flush=True)
time.sleep(600)
"""


def test_a_killed_supervisor_leaves_no_process_even_if_stopped_or_holding_the_gil(tmp_path: Path) -> None:
    """The orphan cleanup is stopped, and so are the fork server and the first child."""
    supervisor = subprocess.Popen(
        [sys.executable, "-P", "-c", SUPERVISOR, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert supervisor.stdout is not None
    pids = [int(supervisor.stdout.readline()) for _ in range(5)]
    for pid in pids[:3]:
        os.kill(pid, signal.SIGSTOP)
    assert all(alive(pid) for pid in pids)
    try:
        supervisor.kill()
        supervisor.wait()
        until(lambda: not any(alive(pid) for pid in pids))
    finally:
        supervisor.stdout.close()
        for pid in filter(alive, pids):
            os.kill(pid, signal.SIGKILL)


def alive(pid: int) -> bool:
    try:
        return stat(pid)[0] != "Z"
    except OSError:
        return False
