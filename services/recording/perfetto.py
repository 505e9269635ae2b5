"""Export of a recording as a trace for https://ui.perfetto.dev: the delays between an estimate and its thrust.

    process     one track; for the controller one slice for each cycle, with its stages inside; for the others one slice
                for each step that has published something, from its cause to its last output
    thrusters   one slice for each plan while it is followed, and the delivered thrusts as counters
    arrows      from the estimate to the cycle that used it, and on to the thrust
    marks       events

Times are vehicle times from the recording's start, so a run at ten times real time shows the delays that its vehicle
had. Stages are measured by the wall clock: within a cycle they are scaled by its ratio of vehicle to wall time, and
time that belongs to no stage (``--compute-delay-s``) lies between the last two. In lock step nothing takes time except
by settings; a slice is drawn at least ``MIN_SLICE_NS`` wide, so that it is visible and can hold an arrow.

Source: Trace Event Format (Chrome), the JSON that Perfetto reads.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeAlias

import msgspec
from msgspec import Meta

from services.bus import topics
from services.recording.records import start_of
from services.recording.recover import Progress, RawMessage, no_progress, read_segments
from services.recording.writer import VEHICLE_MODE

MIN_SLICE_NS = 1000
STEPS, THRUSTERS = 1, 2
"""Tracks of a process."""

FIRST_PROCESSES = ("sensors", "estimator", "controller", "plant")
"""Processes from top to bottom, in the order of the data flow."""

RUNTIME_KEYS = ("record", "status", "event", "rejected", "timing", "clock")
"""Messages of the runtime, which are not outputs of a step."""


PlanId: TypeAlias = tuple[int, int]
"""Epoch and sequence."""


class TraceSummary(msgspec.Struct, frozen=True, kw_only=True):
    """Contents of a trace file."""

    file: str
    processes: int
    slices: int
    arrows: int
    marks: int
    unreadable: int


Ns: TypeAlias = Annotated[int, Meta(ge=-(2**62), le=2**62)]
Count: TypeAlias = Annotated[int, Meta(ge=0, le=2**53 - 1)]


class _Header(msgspec.Struct):
    epoch: Count
    sequence: Count


class _Entry(msgspec.Struct):
    key: str
    received_t_ns: Ns


class _Step(msgspec.Struct):
    t_ns: Ns
    cause: str
    inbox: list[_Entry]


class _Record(msgspec.Struct):
    node: str
    epoch: Count
    step: Count
    steps: list[_Step]


class _Timing(msgspec.Struct):
    epoch: Count
    t_ns: Ns
    compute_ns: Count
    compute_wall_ns: Count
    estimate_age_ns: Ns
    stage_us: dict[str, Annotated[float, Meta(le=1e12)]]


class _Solve(msgspec.Struct):
    status: str
    iterations: Count


class _Plan(msgspec.Struct):
    epoch: Count
    sequence: Count
    cycle_t_ns: Ns
    t_ns: list[Ns]
    origin: str
    estimate_t_ns: Ns
    expected_delay_ns: Ns
    solve: _Solve
    why: str = ""


class _Applied(msgspec.Struct):
    t_ns: Ns
    thrust_N: tuple[float, float, float]
    plan_epoch: Count
    plan_sequence: Ns
    plan_received_t_ns: Ns
    plan_late: bool


class _Estimate(msgspec.Struct):
    epoch: Count
    t_ns: Ns


class _Event(msgspec.Struct):
    t_ns: Ns
    node: str
    kind: str
    text: str


class _Slice(NamedTuple):
    begin_ns: int
    end_ns: int
    name: str
    args: dict[str, Any]


class _ArrowPoint(NamedTuple):
    """Point in a slice at which an arrow begins or ends."""

    node: str
    track: int
    t_ns: Ns


class _Followed(NamedTuple):
    """Plan that the actuators follow."""

    plan: PlanId
    received_ns: int
    late: bool


_DECODERS: dict[type, Callable[[bytes], Any]] = {
    kind: msgspec.json.Decoder(kind).decode for kind in (_Header, _Record, _Timing, _Plan, _Applied, _Estimate, _Event)
}


class _TraceData:
    """Data of a recording that go into its trace."""

    def __init__(self) -> None:
        self.steps: dict[str, list[_Slice]] = {}
        self.estimates: dict[int, tuple[str, int]] = {}  # validity time -> process, publication
        self.plans: dict[PlanId, _Plan] = {}
        self.timings: dict[tuple[int, int], _Timing] = {}  # epoch, start of the cycle
        self.followed: list[_Followed] = []
        self.thrusts: list[_Applied] = []
        self.events: list[_Event] = []
        self.unreadable = 0
        self._nodes_of: dict[int, set[str]] = {}
        self._open: dict[str, tuple[_Record, int]] = {}  # the newest steps by process, and their last output

    def add(self, raw: RawMessage) -> None:
        try:
            self._add(raw)
        except (msgspec.DecodeError, ValueError, RecursionError):
            self.unreadable += 1

    def finish(self) -> None:
        for node in list(self._open):
            self._close(node)

    def step_of(self, estimate_t_ns: int) -> _ArrowPoint | None:
        """Return the step that published the estimate of that validity time; None if it is unknown."""
        if estimate_t_ns not in self.estimates:
            return None
        node, published_ns = self.estimates[estimate_t_ns]
        steps = self.steps.get(node, [])
        i = bisect_right(steps, published_ns, key=lambda step: step.begin_ns) - 1
        return _ArrowPoint(node, STEPS, steps[i].begin_ns) if i >= 0 else None

    def _add(self, raw: RawMessage) -> None:
        first = raw.key.partition("/")[0]
        match raw.key:
            case "timing":
                timing: _Timing = _DECODERS[_Timing](raw.data)
                self.timings[timing.epoch, timing.t_ns] = timing
            case "applied":
                self._applied(_DECODERS[_Applied](raw.data))
            case _ if first == "record":
                self._record(_DECODERS[_Record](raw.data))
            case _ if first == "event":
                self.events.append(_DECODERS[_Event](raw.data))
            case "plan":
                plan: _Plan = _DECODERS[_Plan](raw.data)
                self.plans[plan.epoch, plan.sequence] = plan
        if first not in RUNTIME_KEYS:
            self._output(raw)

    def _record(self, record: _Record) -> None:
        self._close(record.node)
        self._nodes_of.setdefault(record.epoch, set()).add(record.node)
        self._open[record.node] = record, 0

    def _output(self, raw: RawMessage) -> None:
        header: _Header = _DECODERS[_Header](raw.data)
        node = self._writer(raw.key, header.epoch)
        if node in self._open:
            record, last_ns = self._open[node]
            self._open[node] = record, max(last_ns, raw.t_ns) if last_ns else raw.t_ns
        if raw.key == "estimate":
            estimate: _Estimate = _DECODERS[_Estimate](raw.data)
            self.estimates[estimate.t_ns] = node, raw.t_ns
            if node not in self._open:  # a foreign navigation system, which has no step records
                shown = _Slice(raw.t_ns, raw.t_ns + MIN_SLICE_NS, "estimate", {"validity_s": estimate.t_ns / 1e9})
                self.steps.setdefault(node, []).append(shown)

    def _writer(self, key: str, epoch: int) -> str:
        """Return the writer of a message, by its epoch; in lock step, where all share one epoch, by its topic."""
        nodes = self._nodes_of.get(epoch, set())
        if len(nodes) == 1:
            return next(iter(nodes))
        topic = topics.topic_at(key)
        return "unknown" if topic is None else topic.written_by

    def _close(self, node: str) -> None:
        record, end_ns = self._open.pop(node, (None, 0))
        if record is None or not record.steps or not end_ns or node == "controller":
            return  # a step without outputs, or one of the controller, whose cycles tell more
        step, number = record.steps[-1], record.step + len(record.steps) - 1
        caused = step.cause not in ("grid", "cycle") and step.inbox
        begin_ns = step.inbox[-1].received_t_ns if caused else step.t_ns
        before = self.steps.setdefault(node, [])
        args = {"step": number, "cause": step.cause, "validity_s": step.t_ns / 1e9}
        if before and begin_ns < before[-1].end_ns:  # it waited for the step before
            args["waited_ms"] = (before[-1].end_ns - begin_ns) / 1e6
            begin_ns = before[-1].end_ns
        before.append(_Slice(begin_ns, max(end_ns, begin_ns + MIN_SLICE_NS), step.cause, args))

    def _applied(self, applied: _Applied) -> None:
        self.thrusts.append(applied)
        plan = applied.plan_epoch, applied.plan_sequence
        if applied.plan_sequence >= 0 and (not self.followed or self.followed[-1].plan != plan):
            self.followed.append(_Followed(plan, applied.plan_received_t_ns, applied.plan_late))


def write(parts: Sequence[Path], out: Path, *, progress: Progress = no_progress) -> TraceSummary:
    """Write the recording's segments as one trace file. Raises ``ConfigError`` if one is not an MCAP file."""
    data = _TraceData()
    metadata: dict[str, str] = {}
    start_ns = 0
    for reader, raw in read_segments(parts, progress):
        data.add(raw)
        if not metadata:
            metadata = reader.metadata
            start_ns = raw.t_ns if metadata.get("mode") == VEHICLE_MODE else start_of(metadata)
    data.finish()
    trace = _Trace(start_ns)
    trace.draw(data)
    trace.save(out, metadata)
    return TraceSummary(
        file=str(out),
        processes=len(trace.processes),
        slices=trace.slices,
        arrows=trace.arrows,
        marks=len(data.events),
        unreadable=data.unreadable,
    )


class _Trace:
    def __init__(self, start_ns: int) -> None:
        self.start_ns = start_ns
        self.processes: dict[str, int] = {}
        self.slices = self.arrows = 0
        self._head: list[bytes] = []
        self._events: list[tuple[int, int, bytes]] = []  # time, minus duration, the event
        self._ends: dict[tuple[int, int], int] = {}
        for name in FIRST_PROCESSES:
            self._pid(name)

    def draw(self, data: _TraceData) -> None:
        """Draw all tracks, arrows, counters and marks."""
        for node, steps in data.steps.items():
            self._track(node, STEPS, "steps")
            for step in steps:
                self._slice(node, STEPS, step)
        cycles = self._cycles(data)
        thrusts = self._thrusts(data)
        for key, plan in data.plans.items():
            places = data.step_of(plan.estimate_t_ns), cycles.get(key), thrusts.get(key)
            self._arrow([place for place in places if place is not None])
        self._counters(data.thrusts)
        for event in data.events:
            mark = {"ph": "i", "s": "g", "pid": self._pid(event.node), "tid": STEPS, "name": event.kind}
            self._add(event.t_ns, mark | {"args": {"text": event.text}})

    def save(self, out: Path, metadata: dict[str, str]) -> None:
        """Write the events in order of time; of two at the same time first the longer one, which contains the other."""
        self._events.sort(key=lambda event: event[:2])
        about = {
            "vehicle_time_of_0_ns": str(self.start_ns),
            "mode": metadata.get("mode", "unknown"),
            "seed": metadata.get("seed", "unknown"),
        }
        head = msgspec.json.encode({"displayTimeUnit": "ms", "otherData": about})
        with out.open("wb") as file:
            file.write(head[:-1] + b',"traceEvents":[\n')
            file.write(b",\n".join([*self._head, *(event for _, _, event in self._events)]))
            file.write(b"\n]}\n")

    def _cycles(self, data: _TraceData) -> dict[PlanId, _ArrowPoint]:
        """Draw one slice for each cycle, with its stages. Return the begin of each by plan."""
        self._track("controller", STEPS, "cycles")
        begins_of: dict[PlanId, _ArrowPoint] = {}
        plans = {(plan.epoch, plan.cycle_t_ns): plan for plan in data.plans.values()}
        times = sorted(data.timings.keys() | plans.keys(), key=lambda key: key[1])
        for key in times:
            plan, timing = plans.get(key), data.timings.get(key)
            duration_ns = 0 if timing is None else timing.compute_ns
            args: dict[str, Any] = {} if timing is None else {"estimate_age_ms": timing.estimate_age_ns / 1e6}
            name = "cycle"
            if plan is not None:
                name = f"cycle: {plan.origin}"
                args |= {"plan": plan.sequence, "solver": plan.solve.status, "iterations": plan.solve.iterations}
                args |= {"expected_delay_ms": plan.expected_delay_ns / 1e6} | ({"why": plan.why} if plan.why else {})
            begin_ns, end_ns = self._slice("controller", STEPS, _Slice(key[1], key[1] + duration_ns, name, args))
            if plan is not None:
                begins_of[plan.epoch, plan.sequence] = _ArrowPoint("controller", STEPS, begin_ns)
            if timing is not None:
                for stage in _stages(timing, begin_ns, end_ns):
                    self._draw_slice(self._pid("controller"), STEPS, stage.begin_ns, stage.end_ns, stage)
        return begins_of

    def _thrusts(self, data: _TraceData) -> dict[PlanId, _ArrowPoint]:
        """Draw one slice for each followed plan, from its first knot or its arrival. Return the begins by plan."""
        self._track("plant", THRUSTERS, "thrusters")
        begins = []
        for followed in data.followed:
            plan = data.plans.get(followed.plan)
            begins.append(max([followed.received_ns, *(plan.t_ns[:1] if plan is not None else [])]))
        ends = [*begins[1:], *(applied.t_ns for applied in data.thrusts[-1:] if begins)]
        begins_of: dict[PlanId, _ArrowPoint] = {}
        for followed, begin_ns, end_ns in zip(data.followed, begins, ends, strict=True):
            plan = data.plans.get(followed.plan)
            args = {"epoch": followed.plan[0], "late": followed.late, "received_s": followed.received_ns / 1e9}
            name = f"plan {followed.plan[1]}" + (f": {plan.origin}" if plan is not None else "")
            drawn_ns, _ = self._slice("plant", THRUSTERS, _Slice(begin_ns, end_ns, name, args))
            begins_of[followed.plan] = _ArrowPoint("plant", THRUSTERS, drawn_ns)
        return begins_of

    def _arrow(self, places: Sequence[_ArrowPoint]) -> None:
        """Draw one chain of arrows, estimate to cycle to thrust, unless it runs backwards in time."""
        times = [place.t_ns for place in places]
        if len(places) < 2 or times != sorted(times) or times[0] < self.start_ns:
            return
        self.arrows += 1
        for i, place in enumerate(places):
            phase = {0: "s", len(places) - 1: "f"}.get(i, "t")
            event = {"ph": phase, "pid": self._pid(place.node), "tid": place.track, "id": self.arrows}
            event |= {"cat": "delay", "name": "estimate to thrust"} | ({"bp": "e"} if phase == "f" else {})
            self._add(place.t_ns, event)

    def _counters(self, thrusts: list[_Applied]) -> None:
        for applied in thrusts:
            values = dict(zip(("port", "starboard", "vertical"), applied.thrust_N, strict=True))
            event = {"ph": "C", "pid": self._pid("plant"), "tid": 0, "name": "thrust_N", "args": values}
            self._add(applied.t_ns, event)

    def _slice(self, node: str, track: int, of: _Slice) -> tuple[int, int]:
        """Draw a slice. Return its begin and end as drawn: slices of one track do not overlap."""
        pid = self._pid(node)
        begin_ns = max(of.begin_ns, self._ends.get((pid, track), self.start_ns))
        end_ns = self._ends[pid, track] = max(of.end_ns, begin_ns + MIN_SLICE_NS)
        self._draw_slice(pid, track, begin_ns, end_ns, of)
        return begin_ns, end_ns

    def _draw_slice(self, pid: int, track: int, begin_ns: int, end_ns: int, of: _Slice) -> None:
        self.slices += 1
        duration_ns = end_ns - begin_ns
        event = {"ph": "X", "dur": duration_ns / 1000, "pid": pid, "tid": track, "name": of.name, "args": of.args}
        self._add(begin_ns, event, duration_ns)

    def _add(self, t_ns: int, event: dict[str, Any], duration_ns: int = 0) -> None:
        at_ns = max(0, t_ns - self.start_ns)
        self._events.append((at_ns, -duration_ns, msgspec.json.encode({"ts": at_ns / 1000} | event)))

    def _pid(self, name: str) -> int:
        if name not in self.processes:
            pid = self.processes[name] = len(self.processes) + 1
            self._name(pid, 0, "process_name", {"name": name})
            self._name(pid, 0, "process_sort_index", {"sort_index": pid})
        return self.processes[name]

    def _track(self, node: str, track: int, name: str) -> None:
        self._name(self._pid(node), track, "thread_name", {"name": name})

    def _name(self, pid: int, tid: int, what: str, args: dict[str, Any]) -> None:
        self._head.append(msgspec.json.encode({"ph": "M", "pid": pid, "tid": tid, "name": what, "args": args}))


def _stages(timing: _Timing, begin_ns: int, end_ns: int) -> Iterator[_Slice]:
    """Yield the stages, one after the other from the begin of the cycle; the last one ends with the cycle."""
    stages = [(name, us) for name, us in timing.stage_us.items() if us > 0]
    ratio = timing.compute_ns / timing.compute_wall_ns if timing.compute_wall_ns > 0 else 1.0
    at_ns = begin_ns
    for i, (name, us) in enumerate(stages):
        length_ns = round(us * 1000 * ratio)
        if i == len(stages) - 1:
            at_ns = max(at_ns, end_ns - length_ns)
        until_ns = min(at_ns + length_ns, end_ns)
        if until_ns > at_ns:
            yield _Slice(at_ns, until_ns, name, {"wall_us": us})
        at_ns = until_ns
