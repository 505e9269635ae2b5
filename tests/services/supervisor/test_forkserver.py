"""Children have logs and exit codes, none outlives the supervisor, and a fork server that fails is done without."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest

from services.supervisor import forkserver
from services.supervisor.child import last_lines
from services.supervisor.managed_process import ManagedProcess
from services.supervisor.process_group import ProcessGroup
from services.supervisor.process_table import ProcessRow
from tests.procfs import alive, children_of, stat
from tests.waiting import until

QUICK = """
import re, sys, time, types
import msgspec
from services.runtime.lifeline import LIFELINE
from services.supervisor import entry_point, forkserver

class Config(msgspec.Struct):
    task: str
    code: int

def main(config):
    '''In the place of a node: what its config asks for.'''
    print(config.task, flush=True)
    LIFELINE.beat(time.monotonic_ns() // 1000)
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
"""
SERVER, SPAWNED = QUICK + "forkserver.main()", QUICK + "sys.exit(entry_point.run(*sys.argv[1:]))"
"""Programs of a fork server that loads nothing, and of a spawned process, with children that do little."""


class Quick(msgspec.Struct):
    """Config of these children."""

    task: str
    code: int | str = 0


@pytest.fixture
def crew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ProcessGroup]:
    monkeypatch.setattr(forkserver, "PROGRAM", ("-c", SERVER))
    monkeypatch.setattr(forkserver, "ENTRY_POINT", ("-c", SPAWNED))
    crew = ProcessGroup(tmp_path / "scenario.toml", tmp_path, cast(Any, None))
    crew.forks.load()
    until(crew.forks.is_loaded)
    yield crew
    for child in crew.by_name.values():
        child.kill()
    crew.stop(in_order=False, close_session=lambda: None)


def started(crew: ProcessGroup, name: str, task: str, code: int | str = 0) -> ManagedProcess:
    """Return a child that has begun its task, or has ended."""
    crew.start(ProcessRow(name, "quick", True), Quick(task, code))
    child = crew.by_name[name]

    def began() -> bool:
        child.read_heartbeats()
        return bool(last_lines(child.log)) and (child.hang_detector.last_s is not None or child.exit_code() is not None)

    until(began)
    return child


@pytest.mark.parametrize("forked", [True, False])
@pytest.mark.parametrize(
    ("task", "code", "exit_code", "last"),
    [
        ("exits", 7, 7, "exits"),
        ("raises", 0, 1, "RuntimeError: as it was told to"),
        ("exits", "many", 2, "ltv-mpc: Expected `int`, got `str` - at `$.code`"),
    ],
)
def test_a_child_has_its_own_exit_code_and_log(crew, forked, task, code, exit_code, last) -> None:
    if not forked:
        crew.forks._end(crew.forks.servers[0])
    child = started(crew, "plant", task, code)

    until(lambda: child.exit_code() is not None)
    assert child.exit_code() == exit_code
    assert last_lines(child.log)[-1] == last


@pytest.mark.parametrize("forked", [True, False])
def test_a_child_belongs_to_the_supervisor_and_its_group_is_that_of_the_cleanup(crew, forked) -> None:
    if not forked:
        crew.forks._end(crew.forks.servers[0])
    child = started(crew, "plant", "sleeps")
    assert stat(child.pid)[1:3] == [str(os.getpid()), str(crew.cleanup.group)]
    assert Path(f"/proc/{child.pid}/comm").read_text() == "ltv-plant\n"
    assert ("forkserver.main()" in children_of(os.getpid())[child.pid]) == forked
    assert int(Path(f"/proc/{crew.cleanup.group}/statm").read_text().split()[1]) * 4096 < 16e6
    child.kill()
    assert child.exit_code() == -signal.SIGKILL


@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_a_fork_server_that_fails_kills_no_child_and_is_replaced(crew: ProcessGroup, number: signal.Signals) -> None:
    """What a stopped one forks too late ends."""
    first = crew.forks.servers[0].pid
    sensors = started(crew, "sensors", "sleeps")
    os.kill(first, number)
    spawned = started(crew, "plant", "sleeps")
    assert stat(spawned.pid)[1] == str(os.getpid())
    crew.forks.load()
    until(crew.forks.is_loaded)
    spawned.kill()
    spawned.close()
    plant = started(crew, "plant", "sleeps")
    assert "forkserver.main()" in children_of(os.getpid())[plant.pid]
    assert [child.exit_code() for child in crew.by_name.values()] == [None, None]
    assert {sensors.pid, plant.pid, crew.forks.servers[0].pid} <= children_of(os.getpid()).keys()
    until(lambda: not {first, spawned.pid} & children_of(os.getpid()).keys())


@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_its_spare_forks_in_its_place_and_makes_another_spare(crew: ProcessGroup, number: signal.Signals) -> None:
    """The children of both are adopted, in the group of the cleanup."""
    for _ in range(2):
        crew.forks.load()
        first, spare = (server.pid for server in crew.forks.servers)
        os.kill(first, number)
        plant = started(crew, "plant", "sleeps")
        assert crew.forks.servers[0].pid == spare
        assert crew.forks.is_loaded()
        assert "forkserver.main()" in children_of(os.getpid())[plant.pid]
        assert stat(plant.pid)[1] == str(os.getpid())
        assert first not in children_of(os.getpid())
        plant.kill()


def test_what_a_slow_fork_server_forks_too_late_ends_and_takes_nothing_from_the_other_child(crew, monkeypatch) -> None:
    late: list[int | None] = []
    (server,) = crew.forks.servers
    reply = server.reply
    monkeypatch.setattr(server, "reply", lambda timeout_s: late.append(reply(10.0)) if timeout_s else reply(0.0))
    child = started(crew, "plant", "sleeps")
    assert late != [child.pid]
    until(lambda: not alive(late[0] or 0))
    assert child.exit_code() is None


@pytest.mark.parametrize("forked", [True, False])
def test_a_child_that_dies_before_it_is_let_go_on_has_its_exit_code(crew, monkeypatch, forked) -> None:
    """The forked one cannot open its log, and the spawned one stops before it reads its lifeline."""
    if forked:
        (Path(crew.forks.log.parent) / "plant.log").mkdir()
    else:
        monkeypatch.setattr(forkserver, "ENTRY_POINT", ("-c", "raise SystemExit(1)"))
        crew.forks._end(crew.forks.servers[0])
    crew.start(ProcessRow("plant", "quick", True), Quick("sleeps"))
    until(lambda: crew.wait(0.01, lambda: False) or crew.by_name["plant"].exit_code() == 1)


SUPERVISOR = f"""
import sys, time
from pathlib import Path
from services.supervisor import forkserver
from tests.services.supervisor import test_forkserver as test
forkserver.PROGRAM = ("-c", {SERVER!r})
crew = test.ProcessGroup(Path(sys.argv[1]) / "scenario.toml", Path(sys.argv[1]), None)
crew.forks.load()
test.until(crew.forks.is_loaded)
tasks = {{"plant": "sleeps", "controller": "holds the GIL", "recorder": "holds the GIL"}}
pids = [test.started(crew, name, task).pid for name, task in tasks.items()]
print(crew.cleanup.group, crew.forks.servers[0].pid, *pids, flush=True)
time.sleep(600)
"""


def test_a_killed_supervisor_leaves_no_process_even_if_stopped_or_holding_the_gil(tmp_path: Path) -> None:
    """The orphan cleanup is stopped, and so are the fork server and the first child."""
    supervisor = subprocess.Popen([sys.executable, "-c", SUPERVISOR, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert supervisor.stdout is not None
    pids = [int(word) for word in supervisor.stdout.readline().split()]
    for pid in pids[:3]:
        os.kill(pid, signal.SIGSTOP)
    assert len(pids) == 5
    assert all(map(alive, pids))
    try:
        supervisor.kill()
        supervisor.wait()
        until(lambda: not any(map(alive, pids)))
    finally:
        supervisor.stdout.close()
        for pid in filter(alive, pids):
            os.kill(pid, signal.SIGKILL)
