"""Runs of real processes: complete, failed, interrupted, orphaned. tests/system has nodes alone, in another order."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import pytest
from msgspec import structs

from ltv_mpc.currents import read_prior
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Kill, Plan, StepRecord, Truth
from services.bus.options import BusOptions
from services.bus.outbox import Outbox
from services.bus.session import open_session
from services.bus.topics import OPERATOR
from services.cli.app import run as cli
from services.recording import info
from services.recording.reader import Recording
from services.replay import replay
from services.run import folder
from services.run.run_config import Override, RunConfig, resolve
from services.runtime.stopping import StopRequest, hang_up_with_stderr, stop_on_signals
from services.supervisor import jit_cache, supervisor
from services.supervisor.screen import LiveView
from tests.disk import largest_file
from tests.procfs import alive, children_of, pid_of
from tests.system.alone import CLI, started
from tests.waiting import PATIENCE_S, until


class Screen:
    """Screen that keeps what it shows. While the vehicle dives it does the next ``deed`` as soon as ``settled``."""

    def __init__(self, *deeds: Callable[[], None], settled: Callable[[int], bool] = lambda _: True) -> None:
        self.said: list[str] = []
        self.views: list[LiveView] = []
        self.closed = False
        self._deeds = iter(deeds)
        self._done = 0
        self._settled = settled

    def update(self, view: LiveView) -> None:
        self.views.append(view)
        if view.phase == "diving" and self._settled(self._done):
            next(self._deeds, lambda: None)()
            self._done += 1

    def wait(self, what: str, share: float) -> None:
        pass

    def say(self, text: str) -> None:
        self.said.append(text)

    def close(self) -> None:
        self.closed = True


class Page:
    """Live page that a browser has opened. It is drawn ``drawn_s`` after the clock could have started."""

    def __init__(self, drawn_s: float = 0.0) -> None:
        self.bus: list[BusOptions] = []
        self.shown: list[str] = []
        self.asked_s: list[float] = []
        self._drawn_s = drawn_s

    def start(self, bus: BusOptions) -> None:
        self.bus.append(bus)

    def show(self, preparation: str) -> None:
        self.shown.append(preparation)

    @property
    def awaited(self) -> bool:
        self.asked_s.append(time.monotonic())
        return self.asked_s[-1] - self.asked_s[0] < self._drawn_s


class WatchedRun(NamedTuple):
    """Run that several tests look at."""

    place: folder.RunFolder
    outcome: supervisor.Outcome
    screen: Screen
    page: Page
    children_left: dict[int, str]


def run_config(duration_s: float, *more: str) -> RunConfig:
    settings = (f"run.duration_s={duration_s}", "run.speed=10", "run.compute_delay_s=0.05", *more)
    return resolve("descent", [Override("test", settings)])


def recorded(path: Path) -> tuple[info.Info, dict[str, info.Key]]:
    """Return the figures of a recording, and those of each key."""
    found = info.read([path])
    return found, {key.key: key for key in found.keys}


def dives(recording: Path) -> bool:
    """Return True if the file has a plan for the descent so far."""
    if recording.stat().st_size < 100_000:
        return False
    return any(message.kind is Plan and message.plain["cycle_t_ns"] > 0 for message in Recording(recording))


@pytest.fixture
def launcher(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """Run ``ltv-mpc sim`` in a process of its own, without stderr; the vehicle dives and is recorded."""
    out = tmp_path / "run"
    log = (tmp_path / "launcher.log").open("wb")
    words = [*CLI, "sim", "descent", "--duration-s", "600", "--out", str(out)]
    process = subprocess.Popen(["sh", "-c", 'exec "$@" 2>&-', "sh", *words], stdin=subprocess.DEVNULL, stdout=log)
    try:
        recording = out / "run.mcap"
        until(lambda: process.poll() is not None or (recording.exists() and dives(recording)))
        assert process.poll() is None, (tmp_path / "launcher.log").read_text()
        yield process, out
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        log.close()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> WatchedRun:
    """Run with a prior of the water, a file that is gone when the run begins, and an open page, for which it waits.

    The orphan cleanup is killed, and another process asked for in vain.
    """
    place = tmp_path_factory.mktemp("whole")
    known = place / "known.csv"
    known.write_text("depth_m,v_north_mps,u_east_mps,sd_mps,sd_common_mps\n0,0,0,0.1,0\n50,0.5,-0.25,0.001,0\n")
    s = run_config(8.0, f"estimator.water_prior={known}")
    run = folder.make("test", s.files, out=place / "run")
    known.unlink()
    page = Page(drawn_s=1.0)

    def disturb() -> None:
        (pid,) = (pid for pid, words in children_of(os.getpid()).items() if "killpg" in words)
        os.kill(pid, signal.SIGKILL)
        with open_session(structs.replace(page.bus[0], role=OPERATOR), stop=StopRequest(), say=print) as session:
            Outbox(session, node=OPERATOR, epoch=1, kinds=(Kill,)).publish(Kill(node="nobody\n"))

    screen = Screen(disturb)
    outcome = supervisor.Supervisor(s, run, screen, page).run()
    return WatchedRun(run, outcome, screen, page, children_of(os.getpid()))


def test_a_run_of_processes_records_every_message_and_leaves_no_process(whole: WatchedRun) -> None:
    run, outcome, screen, _, children_left = whole
    assert (outcome.exit_code, outcome.why) == (0, ""), (outcome, screen.said)
    found, keys = recorded(run.recording)
    assert (found.whole, found.missing) == (True, 0)
    assert "none lost" in (run.path / "logs" / "recorder.log").read_text()
    steps: Counter[str] = Counter()
    for message in Recording(run.recording):
        if message.kind is StepRecord:
            steps[message.plain["node"]] += len(message.plain["steps"])
    assert (keys["world/truth"].messages, steps["plant"]) == (901, 181)
    assert keys["plan"].messages == keys["timing"].messages
    assert outcome.summary is not None
    assert (run.path / "summary.json").exists()
    assert outcome.summary.messages.dropped == outcome.summary.messages.rejected == 0
    assert outcome.summary.compute_delay_s.median is not None
    assert outcome.summary.compute_delay_s.median > 0.05  # added in vehicle time
    assert not children_left
    assert screen.closed
    assert {view.phase for view in screen.views} >= {"starting", "diving"}
    assert isinstance(screen.views[-1].truth, Truth)
    assert isinstance(screen.views[-1].plan, Plan)
    assert screen.views[-1].plan.authority == "controller"  # the plant has armed it
    verdict = replay.replay(replay.Run(run.recording))
    assert verdict.identical, verdict.first_difference
    # Nothing was lost: every step of every process.
    assert steps.keys() >= {"plant", "sensors", "estimator", "controller"}
    assert verdict.steps_compared == verdict.steps_run == steps.total()


def test_a_request_to_kill_an_unknown_process_is_refused_and_changes_nothing(whole: WatchedRun) -> None:
    refused = [line for line in whole.screen.said if "kill" in line]
    assert refused == ['kill refused: no process "nobody\\n" in this run']


def run_with_empty_cache(
    path: Path, monkeypatch: pytest.MonkeyPatch, fill: Callable[..., int], page: Page | None = None
) -> supervisor.Outcome:
    """Return the outcome of a run that compiles by ``fill``: of the processes the router alone is there."""
    empty_cache = SimpleNamespace(is_warm=lambda: False, fill=fill, NOTE=jit_cache.NOTE)
    monkeypatch.setattr(supervisor, "jit_cache", empty_cache)
    s = run_config(3.0)
    outcome = supervisor.Supervisor(s, folder.make("test", s.files, out=path), Screen(), page).run()
    assert outcome.exit_code == 1
    assert not children_of(os.getpid())
    return outcome


def test_the_page_can_connect_before_anything_is_compiled_and_shows_the_share(tmp_path, monkeypatch) -> None:
    page = Page()

    def fill(_scenario: object, _log: object, wait: Callable[[float], None]) -> int:
        socket.create_connection(("127.0.0.1", int(page.bus[0].connect[0].rpartition(":")[2]))).close()
        wait(0.43)
        return 3  # the run ends here

    run_with_empty_cache(tmp_path / "run", monkeypatch, fill, page)
    assert [text for text in page.shown if "43% after 0 s" in text], page.shown


def test_a_deleted_folder_ends_the_run_with_exit_1_and_its_name(tmp_path, monkeypatch) -> None:
    path = tmp_path / "run"

    def fill(_scenario: object, _log: object, wait: Callable[[float], None]) -> int:
        shutil.rmtree(path)
        wait(0.5)
        return 0  # not reached

    outcome = run_with_empty_cache(path, monkeypatch, fill)
    assert outcome.why == f"{path}: the folder was deleted during the run"


def test_on_an_empty_cache_nothing_is_compiled_before_the_run_says_so(tmp_path: Path) -> None:
    """Otherwise the address of the live page would come later: the supervisor proposes the horizon in plain Python."""
    cache = tmp_path / "cache"
    environment = ("env", f"NUMBA_CACHE_DIR={cache}")
    with started(*environment, *CLI, "sim", "--out", str(tmp_path / "run")) as (process, lines):
        lines.until(lambda line: line.strip() == jit_cache.NOTE)
        assert not list(cache.rglob("*.nbc"))
        assert any(line.startswith("horizon 13.8 s") for line in lines.said), lines.said
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 130


def check_wait(screen: Screen, page: Page, limit_s: float) -> None:
    """Check that the clock waited until the page was drawn, or for ``limit_s``, and then ran."""
    waited_s = page.asked_s[-1] - page.asked_s[0]
    assert 0.5 * limit_s < waited_s
    assert {view.phase for view in screen.views[: len(page.asked_s)]} == {"starting"}


def test_the_clock_waits_until_an_open_page_is_drawn(whole: WatchedRun) -> None:
    check_wait(whole.screen, whole.page, 1.0)
    assert whole.page.shown == ["starting the processes"]


@pytest.fixture(scope="module")
def without_room(tmp_path_factory: pytest.TempPathFactory) -> WatchedRun:
    """Run with a page that is never drawn. The disk takes the settings, and not a second of the recording."""
    s = run_config(3.0)
    run = folder.make("test", s.files, out=tmp_path_factory.mktemp("without_room") / "run")
    screen, page = Screen(), Page(drawn_s=1000.0)
    with pytest.MonkeyPatch.context() as patch, largest_file(100_000):
        patch.setattr(supervisor, "DRAWING_TIMEOUT_S", 0.5)
        outcome = supervisor.Supervisor(s, run, screen, page).run()
    return WatchedRun(run, outcome, screen, page, children_of(os.getpid()))


def test_the_clock_does_not_wait_for_an_open_page_for_ever(without_room: WatchedRun) -> None:
    check_wait(without_room.screen, without_room.page, 0.5)
    assert "diving" in {view.phase for view in without_room.screen.views}


def test_a_run_whose_recording_found_no_room_is_not_complete(without_room: WatchedRun) -> None:
    run, outcome, *_ = without_room
    assert outcome.exit_code == 1, outcome
    assert outcome.why
    assert not list(run.path.rglob("*.part"))


def test_the_estimator_starts_from_the_prior_and_the_run_saves_its_profile(whole: WatchedRun) -> None:
    """A current deeper than the profiler's range, which only the file can have provided."""
    learned = read_prior(whole.place.path / "currents.csv")
    (at,) = (learned.depth_m == 50.0).nonzero()[0]
    assert learned.north_mps[at] == pytest.approx(0.5, abs=0.03)
    assert learned.east_mps[at] == pytest.approx(-0.25, abs=0.03)
    assert learned.sd_mps[at] < 0.02


def test_a_killed_or_hung_process_continues_where_it_was_and_a_killed_sensors_process_ends_the_run(tmp_path) -> None:
    """One after the other, each as soon as the one before is back; first the fork server, which is replaced."""
    s = resolve("hover", [Override("test", ["run.duration_s=600", "run.surface_time_s=2", "run.speed=1"])])
    run = folder.make("test", s.files, out=tmp_path / "run")
    harm = [
        ("forkserver", signal.SIGKILL),
        ("recorder", signal.SIGKILL),
        ("router", signal.SIGKILL),
        ("controller", signal.SIGKILL),
        ("estimator", signal.SIGSTOP),
        ("sensors", signal.SIGKILL),
    ]

    def harmful(name: str, number: signal.Signals) -> Callable[[], None]:
        return lambda: os.kill(pid_of(name, os.getpid()), number)

    def is_settled(done: int) -> bool:
        crew = crewed.processes
        settled = not crew.recovering and not crew.pending and crew.forks.is_loaded()
        return settled and len(crew.restarts_s) == max(0, done - 1)

    screen = Screen(*(harmful(*each) for each in harm), settled=is_settled)
    crewed = supervisor.Supervisor(s, run, screen)
    outcome = crewed.run()
    assert outcome.why == "sensors was ended by SIGKILL", (outcome, screen.said)
    assert any("sensors: waiting for" in line for line in outcome.last_lines)
    assert outcome.exit_code == 1
    assert outcome.summary is not None
    assert outcome.summary.restarts == 4
    assert not children_of(os.getpid())
    summary = folder.read_summary(run.recording)
    assert (summary["completed"], summary["why"]) == (False, outcome.why)
    found, _ = recorded(run.recording)
    assert found.why in ("", outcome.why)  # empty: a loaded host has killed the recorder
    assert [path.name for path in run.path.glob("*.mcap")] == ["run.mcap"]
    names = ["recorder", "router", "controller", "estimator"]
    assert [line.split()[3] for line in screen.said if "recovered" in line] == names
    back = [event.text.split()[0] for event in found.events if (event.node, event.kind) == ("supervisor", "restart")]
    assert back in (names, names[1:])  # the first one may have been on its way when the router was killed

    begins: dict[str, list[str]] = {}  # key of the first message of each start, by node
    for stored in Recording(run.recording):
        if stored.kind is StepRecord and stored.plain["step"] == 0:
            inbox = stored.plain["steps"][0]["inbox"]
            begins.setdefault(stored.plain["node"], []).append(inbox[0]["key"] if inbox else "")
    assert begins["controller"][1:] == ["state/controller"]
    assert begins["estimator"][1:] == ["state/estimator"]
    assert outcome.summary.tracking_error_m.max is not None
    assert outcome.summary.tracking_error_m.max < 1.0  # where it was, not where it began
    assert outcome.summary.messages.dropped > 0  # what nobody recorded while there was no recorder
    verdict = replay.replay(replay.Run(run.recording))
    assert verdict.identical, verdict.first_difference
    for node in verdict.nodes:
        if node.node in ("controller", "estimator"):
            # The second start whole; the first up to the recorder's death, unless nobody heard of it after that.
            assert node.starts == 2
            # A killed recorder may have written the record of its last step, and not the outputs.
            left_out = node.steps_run - sum(gap.steps for gap in node.gaps) - node.steps_compared
            assert 0 <= left_out <= min(1, node.outputs_lost)
            assert len({gap.epoch for gap in node.gaps}) <= 1
            assert node.node == "controller" or len(node.gaps) == 1


def test_ctrl_c_ends_everything_in_order_and_leaves_a_valid_recording(launcher) -> None:
    process, out = launcher
    pids = children_of(process.pid)
    assert len(pids) >= 7  # six, the guard, and who forks them
    process.send_signal(signal.SIGINT)
    until(lambda: not any(alive(pid) for pid in pids))
    assert process.wait(PATIENCE_S) == 130  # after the summary of what there is
    assert json.loads((out / "summary.json").read_text())["duration_s"] < 200.0
    assert "localisation" in (out.parent / "launcher.log").read_text()
    found, keys = recorded(out / "run.mcap")
    assert (found.whole, found.missing) == (True, 0)
    assert keys["world/truth"].messages > 0


class ClosedStream(io.StringIO):
    """Standard error whose reader has gone."""

    def write(self, _: str) -> int:
        raise BrokenPipeError


def test_a_closed_stderr_requests_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", ClosedStream())
    with stop_on_signals() as request, hang_up_with_stderr():
        sys.stderr.write("told")
        until(request)
    assert not request.interrupted


def test_with_json_the_clock_waits_for_no_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def no_sidecar(*_: object, waits: bool, **__: object) -> None:
        asked.append(waits)
        raise ConfigError("page", "", "none here")

    monkeypatch.setattr("services.dashboard.sidecar.Sidecar", no_sidecar)
    for name, words in (("a", []), ("b", ["--json"])):
        assert cli(["sim", "--open", *words, "--out", str(tmp_path / name)]) == 2
    assert asked == [True, False]


def test_a_killed_supervisor_leaves_no_orphan_and_the_recorder_completes_its_file(launcher) -> None:
    """One child is stopped, so that it cannot end itself (for one that holds the GIL: test_forkserver)."""
    process, out = launcher
    pids = children_of(process.pid)
    os.kill(pid_of("estimator", process.pid), signal.SIGSTOP)
    process.kill()
    until(lambda: not any(alive(pid) for pid in pids))
    assert recorded(out / "run.mcap")[0].whole
