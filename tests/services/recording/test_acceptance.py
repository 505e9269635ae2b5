"""Attacks on the figures of a run: frames that its readers refuse change no figure but the number of rejections."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from ltv_mpc.messages import Applied, Message, NodeStatus, Plan, RejectedFrame, RunEvent
from services.bus import topics, wire
from services.bus.wire import Header
from services.recording import info
from services.recording.writer import RunWriter
from services.reporting import report
from services.reporting.plots import recorded
from services.run.run_config import resolve
from services.run.summary import summarise_recording
from sim.evaluation.summary import Summary
from tests.services.recording.recordings import write
from tests.services.reporting import synthetic_run as made
from tests.services.words import status

STRANGER, S = 99, 1_000_000_000
Frame = tuple[str, type[Message], dict[str, Any]]

REJECTED = RejectedFrame(t_ns=0, node="estimator", key="plan", reason="range", crc=0, payload_base64="")


def frame(key: str, message: Message, *, epoch: int = STRANGER, sequence: int = 0, **changed: Any) -> Frame:
    return key, type(message), wire.to_map(message, Header(epoch=epoch, sequence=sequence)) | changed


def event(t_ns: int, node: str, kind: str = "") -> Message:
    return RunEvent(t_ns=t_ns, node=node, kind=kind, text="")


def far(t_ns: int) -> Message:
    return replace(made.estimate(t_ns), north_m=75.0)


Attack = Callable[[int, int], list[Frame]]
ATTACKS: dict[str, Attack] = {
    "a huge sequence number": lambda t, k: [frame("applied", made.applied(t), epoch=made.EPOCH, sequence=2**50 + k)],
    "huge first sequence numbers": lambda t, k: [
        frame("sensor/usbl", made.clock(t), sequence=2**50, kind=0),
        frame("event/x", event(t, "x", "fault"), epoch=STRANGER + k, sequence=2**50),
    ],
    "estimates of a second source": lambda t, k: [frame("estimate", far(t), sequence=k)],
    "estimates of many starts": lambda t, k: [frame("estimate", far(t), epoch=STRANGER + k, sequence=10)],
    "estimates of a named source": lambda t, k: [frame("estimate/other", far(t), sequence=k)],
    "plans of a second controller": lambda t, k: [frame("plan", made.plan(t), sequence=k)],
    "replayed reports of the actuators": lambda t, k: [
        frame("applied", made.applied(0), epoch=made.EPOCH, sequence=k),
        frame("applied", replace(made.applied(t), command_N=(1e3, 1e3, 0.0)), sequence=k),
    ],
    "false truths": lambda _, k: [frame("world/truth", made.truth(0), sequence=k)],
    "a false clock": lambda t, k: [frame("clock", made.clock(t, speed=1), sequence=k)],
    "a false fence": lambda t, k: [frame("fence", made.fence(t), sequence=k)],
    "statuses of other starts and of a program beside the run": lambda _, k: [
        frame("status/sensors", status("sensors", rejected=10**12), epoch=STRANGER + k),
        frame("status/operator", status("operator", rejected=10**12), sequence=k),
    ],
    "statuses, events and rejections under another name": lambda t, k: [
        frame("status/x", status("sensors", rejected=10**12), sequence=k),
        frame("event/x", event(t, "supervisor", "fault"), sequence=k),
        frame("rejected/x", REJECTED, sequence=k),
    ],
    "messages of a program beside the run, of which some are missing": lambda t, k: [
        frame(f"event/{node}", event(t, node), sequence=2 * k) for node in ("x", "display")
    ],
    "messages under the name of a process, of which some are missing": lambda t, k: [
        frame(f"event/{node}", event(t, node), epoch=STRANGER + k, sequence=10) for node in ("sensors", "ros2")
    ],
    "a frame without a message": lambda *_: [
        (key, kind, {"epoch": 5, "sequence": 0})
        for key, kind in (("rejected/x", RejectedFrame), ("status/x", NodeStatus), ("plan", Plan), ("applied", Applied))
    ],
    "wrong types": lambda t, _: [
        ("applied", Applied, wire.to_map(made.applied(t), Header(epoch=7, sequence=0)) | {"t_ns": [], "epoch": {}})
    ],
}  # fmt: skip


def messages() -> Iterator[tuple[str, Message, int]]:
    for node, message, t_ns in made.dive(6.0):
        yield node, message, t_ns
        if t_ns % (5 * S) == 0:  # 0.5 s at ten times real time
            yield from ((process, status(process, rejected=1), t_ns) for process in ("sensors", "recorder"))


def record(path: Path, attack: Attack | None = None) -> Path:
    with RunWriter(path, start_ns=-S, metadata={"mode": "services", "config/vehicle.toml": made.VEHICLE}) as writer:
        sequences: dict[str, int] = {}
        attacks = 0
        for node, message, t_ns in messages():
            key = topics.key_of(type(message), node)
            sequence = sequences[key] = sequences.get(key, -1) + 1
            writer.write(node, message, Header(epoch=made.EPOCH, sequence=sequence), t_ns)
            if attack is not None and t_ns > S and t_ns % S == 50_000_000:
                for where, kind, plain in attack(t_ns, attacks):
                    writer.write_plain(where, kind, plain, t_ns)
                attacks += 1
    return path


def summary_of(path: Path) -> Summary:
    return summarise_recording(resolve("descent"), path)[0]


@pytest.fixture(scope="module")
def unharmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Summary, recorded.PlotData]:
    path = record(tmp_path_factory.mktemp("unharmed") / "run.mcap")
    return summary_of(path), recorded.read(path)


@pytest.mark.parametrize("attack", ATTACKS.values(), ids=ATTACKS)
def test_a_frame_that_the_readers_refuse_changes_no_figure(attack, unharmed, tmp_path) -> None:
    before, plots = unharmed
    path = record(tmp_path / "run.mcap", attack)
    after = summary_of(path)
    counts = after.messages
    assert replace(after, messages=before.messages) == before
    assert counts.dropped == before.messages.dropped == 0
    assert counts.published - before.messages.published in range(16)  # those that a program may publish
    assert counts.rejected - before.messages.rejected in range(41)
    drawn = recorded.read(path)
    assert drawn.tables == plots.tables
    assert [one for one in drawn.safety.processes() if one.name in ("sensors", "recorder")] == plots.safety.processes()


def test_the_plan_with_which_another_controller_takes_over_counts(tmp_path) -> None:
    messages: list[tuple[str, Message, int, int, int]] = []
    for t_ns, epoch, sequence, followed in ((0, 1, 0, 1), (S, 1, 1, 1), (2 * S, 2, 0, 1), (3 * S, 2, 1, 2)):
        messages.append(("controller", made.plan(t_ns), epoch, sequence, t_ns))
        messages.append(("plant", replace(made.applied(t_ns), plan_epoch=followed), 7, t_ns // S, t_ns))
    assert summary_of(write(tmp_path / "run.mcap", messages, start_ns=0)).cycles == 4


def test_a_run_that_ended_early_says_so_in_summary_and_report(tmp_path) -> None:
    ended = RunEvent(t_ns=0, node="supervisor", kind="ended", text="plant failed <twice>")
    path = write(tmp_path / "run.mcap", [("supervisor", ended, 1, 0, 0)], mode="services")
    summary = summary_of(path)
    assert (summary.completed, summary.why) == (False, "plant failed <twice>")
    assert info.read([path]).why == summary.why
    lines = report._lines([report.Run(name="x", recording=path, summary={"why": summary.why})], [recorded.read(path)])
    assert lines[0] == '<p class="bad">The run failed: plant failed &lt;twice&gt;</p>'
