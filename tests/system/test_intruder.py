"""A run under attack: the frames of an intruder are denied or rejected, counted, and never used by the vehicle.

Ctrl-C then ends all of its processes, and leaves a recording and a summary.
"""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from ltv_mpc.messages import NodeStatus, RunEvent, StepRecord
from services.bus import certificates
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.roles import ROLES
from services.bus.session import Session, open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import decode
from services.processes import router
from services.recording import info
from services.runtime.stopping import StopRequest
from services.supervisor.entry_point import read_config
from tests.procfs import alive, children_of
from tests.waiting import PATIENCE_S, until

CLI = [sys.executable, "-P", "-m", "services.cli"]
INTRUDER = Path(__file__).with_name("intruder.py")
FORGED_EPOCH = 0xBAD
ENOUGH = 50  # messages that steps were given, to say something of them


WRONG_ROLE = 8000
"""Frames at least that the router denies."""

REFUSED = 500
"""Frames that the controller refuses at least, while the intruder goes on: a loaded host loses some of a flood."""

OWN_ESTIMATES = 200
"""Estimates of the run in the three seconds of a replay, or in the ten that they last on a busy host."""


def router_of(run: Path, launcher: subprocess.Popen[bytes], log: Path) -> tuple[str, str]:
    """Return endpoint and namespace from the configuration of the router."""
    recording = run / "run.mcap"
    until(lambda: launcher.poll() is not None or (recording.exists() and recording.stat().st_size > 100_000))
    assert launcher.poll() is None, log.read_text()
    config: router.Config = read_config(run / "logs" / "router.json", router.Config)
    return config.bus.listen[0], config.bus.namespace


class Ears:
    """Log of the processes' status: their steps, their counts, and what the router has denied."""

    def __init__(self, session: Session) -> None:
        self._box = Mailbox()
        self.taken: list[tuple[str, int, int]] = []  # key, epoch, sequence: into steps of plant and controller
        self.own: set[int] = set()  # epochs of the run's processes
        self.rejected: dict[str, int] = {}
        self.denied: list[str] = []
        for kind in (StepRecord, NodeStatus, RunEvent):
            session.subscribe(f"{BY_TYPE[kind].key}/*", BY_TYPE[kind], self._box)

    def hear(self) -> None:
        """Take in what has arrived."""
        while (frame := self._box.take(0.0)) is not None:
            assert frame.topic is not None
            said, header = decode(frame.topic.message_type, frame.payload)
            if isinstance(said, NodeStatus):
                self.own.add(header.epoch)
                self.rejected[said.node] = said.rejected
            elif isinstance(said, StepRecord) and said.node in ("plant", "controller"):
                self.taken += [(entry.key, entry.epoch, entry.sequence) for step in said.steps for entry in step.inbox]
            elif isinstance(said, RunEvent) and said.node == "router":
                self.denied.append(said.text)


@contextmanager
def killed(*command: str, **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Run a process that does not outlive the block."""
    with subprocess.Popen(command, **options) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.timeout(600)
def test_ten_thousand_frames_of_an_intruder_reach_neither_plant_nor_controller_and_ctrl_c_ends_the_run(
    tmp_path: Path,
) -> None:
    run, certs, foreign, log = (tmp_path / name for name in ("run", "certs", "foreign", "launcher.log"))
    certificates.make(certs, ROLES, days=1)
    certificates.make(foreign, ROLES, days=1)
    options = ("--duration-s", "1000", "--speed", "2", "--certs", str(certs), "--out", str(run))
    with (
        log.open("wb") as output,
        killed(*CLI, "sim", *options, stdin=subprocess.DEVNULL, stdout=output, stderr=output) as launcher,
    ):
        endpoint, namespace = router_of(run, launcher, log)
        attack = sys.executable, str(INTRUDER), endpoint, namespace, str(certs), str(foreign)
        bus = BusOptions(connect=(endpoint,), namespace=namespace, certs=certs, role="display")
        with (
            open_session(bus, stop=StopRequest(), say=print) as session,
            killed(*attack, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as intruder,
        ):
            ears = Ears(session)
            assert intruder.stdout is not None
            assert intruder.stdout.readline() == "sent once\n"

            def turned_away() -> bool:
                assert launcher.poll() is None, log.read_text()
                ears.hear()
                return ears.rejected.get("controller", 0) >= REFUSED and ears.rejected.get("router", 0) >= WRONG_ROLE

            until(turned_away)
            sent = json.loads(intruder.communicate()[0])
            assert intruder.returncode == 0
            until(lambda: ears.hear() or len(ears.taken) >= ENOUGH)
        pids = children_of(launcher.pid)
        assert len(pids) >= 7  # six, the guard, and who forks them
        launcher.send_signal(signal.SIGINT)
        assert launcher.wait(PATIENCE_S) == 130  # after the summary of what there is
        until(lambda: not any(alive(pid) for pid in pids))
    assert sent["denied"] + sent["refused"] + sent["connections"] > 10_000

    # What the plant's and the controller's steps were given, each frame once, comes from the run's own processes.
    assert len(ears.taken) >= ENOUGH
    assert len(set(ears.taken)) == len(ears.taken)
    assert FORGED_EPOCH not in {epoch for _, epoch, _ in ears.taken}
    assert {epoch for _, epoch, _ in ears.taken} <= ears.own

    # The reader counts what it has refused, and the router what it has denied.
    # Replayed frames have the epoch of the true estimator, whose own frames may then exceed the limit of its rate.
    assert REFUSED <= ears.rejected["controller"] <= sent["refused"] + OWN_ESTIMATES
    assert ears.rejected["plant"] == 0
    assert len(ears.denied) <= len(str(sent["denied"] + sent["connections"])) + 1  # at 1, 10, 100, ... and at the end
    assert any(re.search(r"display may not put on \S+/plan", text) for text in ears.denied)
    assert "denied" in log.read_text()
    found, summary = info.read([run / "run.mcap"]), json.loads((run / "summary.json").read_text())
    assert found.whole
    assert {key.key for key in found.keys} >= {"world/truth", "plan"}
    assert summary["duration_s"] < 1000.0
    assert "localisation" in log.read_text()
    counts = summary["messages"]
    assert counts["denied"] >= sent["denied"]
    assert counts["rejected"] >= REFUSED  # the recorder rejects some of them too
    assert f"{counts['denied']} denied" in log.read_text()
