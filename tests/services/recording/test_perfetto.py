"""Export for Perfetto: checked against the rules of the format, and against a run with known delays."""

from __future__ import annotations

import itertools
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import (
    Applied,
    CycleTiming,
    Estimate,
    InboxEntry,
    Message,
    Plan,
    RecordedStep,
    RunEvent,
    StepRecord,
)
from services.recording import perfetto
from services.run import folder
from services.run.run_config import Override, resolve
from services.tools import lockstep_run
from tests.services.bus.messages import EXAMPLES
from tests.services.recording.recordings import START_NS, foreign, write

MS = 1_000_000
ESTIMATOR, CONTROLLER, PLANT = 11, 12, 13
"""Epochs."""

Event = dict[str, Any]


def example(kind: type[Message], **fields: Any) -> Message:
    return msgspec.structs.replace(next(e for e in EXAMPLES if isinstance(e, kind)), **fields)


def held_to_the_rules(trace: dict[str, Any]) -> list[Event]:
    """Check phases and their fields, order of times, nesting of slices, and that arrows begin and end in a slice."""
    events: list[Event] = trace["traceEvents"]
    assert {event["ph"] for event in events} <= set("MXCistf")
    timed = [event for event in events if event["ph"] != "M"]
    assert events[: len(events) - len(timed)] == [event for event in events if event["ph"] == "M"]
    assert all(a["ts"] <= b["ts"] for a, b in itertools.pairwise(timed))
    processes = {event["pid"]: event["args"]["name"] for event in events if event["name"] == "process_name"}
    threads = {(event["pid"], event["tid"]) for event in events if event["name"] == "thread_name"}
    slices: dict[tuple[int, int], list[Event]] = defaultdict(list)
    for event in timed:
        assert event["pid"] in processes
        assert isinstance(event["tid"], int)
        assert event["ts"] >= 0
        assert event["name"]
        match event["ph"]:
            case "X":
                assert event["dur"] > 0
                assert (event["pid"], event["tid"]) in threads
                slices[event["pid"], event["tid"]].append(event)
            case "C":
                assert all(isinstance(value, int | float) for value in event["args"].values())
            case "i":
                assert event["s"] in ("g", "p", "t")
    for track in slices.values():
        open_until: list[float] = []
        for event in track:
            while open_until and open_until[-1] <= event["ts"] + 1e-6:
                open_until.pop()
            end = event["ts"] + event["dur"]
            assert not open_until or end <= open_until[-1] + 1e-6, "slices of a track overlap"
            open_until.append(end)
    flows: dict[int, list[Event]] = defaultdict(list)
    for event in timed:
        if event["ph"] in "stf":
            flows[event["id"]].append(event)
            around = slices[event["pid"], event["tid"]]
            assert any(x["ts"] <= event["ts"] <= x["ts"] + x["dur"] for x in around)
    for flow in flows.values():
        assert [event["ph"] for event in flow] in (["s", "f"], ["s", "t", "f"])
        assert flow[-1]["bp"] == "e"
        assert len({(event["cat"], event["name"]) for event in flow}) == 1
    return events


def drawn(path: Path, out: Path) -> tuple[perfetto.TraceSummary, list[Event]]:
    written = perfetto.write([path], out)
    events = held_to_the_rules(json.loads(out.read_text()))
    assert written.slices == sum(event["ph"] == "X" for event in events)
    assert written.arrows == len({event["id"] for event in events if event["ph"] == "s"})
    return written, events


def cycle(k: int) -> list[tuple[str, Message, int, int, int]]:
    """Record an estimate 100 ms old, published 20 ms ago; a cycle of 40 ms (8 ms of wall time; stages 1 + 3 + 2)
    at speed 5; its plan comes 3 ms later and takes effect 10 ms after that.
    """
    t = k * 300 * MS
    entry = InboxEntry(key="sensor/imu", epoch=1, sequence=k, crc=0, received_t_ns=t - 30 * MS)
    caused = RecordedStep(t_ns=t - 100 * MS, cause="sensor/imu", inbox=(entry,))
    step = StepRecord(node="estimator", epoch=ESTIMATOR, step=k, steps=(caused,))
    plan = example(
        Plan,
        cycle_t_ns=t,
        t_ns=np.arange(18) * 300 * MS + t + 53 * MS,
        estimate_t_ns=t - 100 * MS,
    )
    timing = CycleTiming(
        t_ns=t,
        compute_ns=40 * MS,
        compute_wall_ns=8 * MS,
        estimate_age_ns=100 * MS,
        stage_us={"read": 1000.0, "solve": 3000.0, "publish": 2000.0},
    )
    applied = example(
        Applied,
        t_ns=t + 100 * MS,
        plan_epoch=CONTROLLER,
        plan_sequence=k,
        plan_cycle_t_ns=t,
        plan_received_t_ns=t + 43 * MS,
    )
    return [
        ("estimator", step, ESTIMATOR, k, t - 20 * MS),
        ("estimator", example(Estimate, t_ns=t - 100 * MS), ESTIMATOR, k, t - 20 * MS),
        ("controller", plan, CONTROLLER, k, t + 40 * MS),
        ("controller", timing, CONTROLLER, k, t + 40 * MS),
        ("plant", applied, PLANT, k, t + 100 * MS),
    ]


def test_the_delay_from_an_estimate_to_its_thrust_can_be_read_off(tmp_path: Path) -> None:
    event = RunEvent(t_ns=500 * MS, node="plant", kind="slowed", text="by 0.4 s")
    path = write(tmp_path / "run.mcap", [*cycle(0), *cycle(1), ("plant", event, PLANT, 0, 500 * MS), *cycle(2)])
    written, events = drawn(path, tmp_path / "trace.json")
    assert (written.arrows, written.marks, written.unreadable) == (3, 1, 0)
    names = {event["pid"]: event["args"]["name"] for event in events if event["name"] == "process_name"}

    def slices(process: str, track: int) -> list[Event]:
        found = [e for e in events if e["ph"] == "X" and names[e["pid"]] == process and e["tid"] == track]
        return [e | {"ts": e["ts"] + START_NS / 1000} for e in found]

    t_us = 300_000.0  # of the second cycle
    step = slices("estimator", perfetto.STEPS)[1]
    assert (step["ts"], step["dur"]) == pytest.approx((t_us - 30_000, 10_000))
    cycles = slices("controller", perfetto.STEPS)
    assert [e["name"] for e in cycles[4:8]] == ["cycle: shifted", "read", "solve", "publish"]
    # speed 5: 1 ms on the wall are 5 ms of the vehicle's; what belongs to no stage is before the last one
    places = [(e["ts"] - t_us, e["dur"]) for e in cycles[4:8]]
    assert places == [pytest.approx(place) for place in ((0, 40_000), (0, 5_000), (5_000, 15_000), (30_000, 10_000))]
    followed = slices("plant", perfetto.THRUSTERS)[1]
    assert (followed["ts"], followed["dur"]) == pytest.approx((t_us + 53_000, 300_000))
    chain = [e["ts"] + START_NS / 1000 - t_us for e in events if e.get("id") == 2]
    assert chain == pytest.approx([-30_000, 0, 53_000])
    (mark,) = (e for e in events if e["ph"] == "i")
    assert (mark["name"], mark["args"]["text"]) == ("slowed", "by 0.4 s")


def test_foreign_estimates_have_a_slice_and_arrows_never_point_back(tmp_path: Path) -> None:
    """There is no step record; the second estimate is stamped later than the start of the cycle that used it."""
    first, second = cycle(0), cycle(1)
    late = ("estimator", second[1][1], ESTIMATOR, 1, 310 * MS)
    written, events = drawn(write(tmp_path / "run.mcap", [*first[1:], late, *second[2:]]), tmp_path / "trace.json")
    assert written.arrows == 1
    assert [e["name"] for e in events if e["ph"] == "X" and e["pid"] == 2] == ["estimate", "estimate"]


def test_a_run_in_lock_step_with_a_delay_has_a_slice_a_cycle_and_an_arrow_a_plan(tmp_path: Path) -> None:
    here = resolve("descent", [Override("test", ["run.duration_s=2", "run.compute_delay_s=0.2"])])
    place = folder.make("descent", here.files, out=tmp_path / "run")
    lockstep_run.run(here, place)
    _, events = drawn(place.recording, tmp_path / "trace.json")
    cycles = [e for e in events if e["ph"] == "X" and e["pid"] == 3]
    assert len(cycles) > 5
    assert {e["dur"] for e in cycles} == {200_000.0}
    chains = [e for e in events if e["ph"] == "s"]
    assert len(chains) >= len(cycles) - 1
    assert {e["pid"] for e in chains} == {2}


EVENT = b'{"epoch":1,"sequence":0,"t_ns":1%s,"node":"x","kind":"y","text":"z"}'


def test_invalid_messages_are_counted_and_not_drawn(tmp_path: Path) -> None:
    zeros = b"0" * 400
    rubbish = (
        b"",
        b"[]",
        b'{"epoch":"x"}',
        b"{" * 9,
        b'{"t_ns":1e400}',
        b'{"epoch":1,"t_ns":1%s}' % zeros,
        EVENT % zeros,
    )
    keys = ("plan", "timing", "applied", "estimate", "record/plant", "event/x")
    parts = [foreign(tmp_path / f"{k}.mcap", key, *rubbish) for k, key in enumerate(keys)]
    out = tmp_path / "trace.json"
    written = perfetto.write(parts, out)
    held_to_the_rules(json.loads(out.read_text()))
    assert (written.slices, written.marks, written.unreadable) == (0, 0, 42)
