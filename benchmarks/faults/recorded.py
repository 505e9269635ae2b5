"""Recording of a run of processes, read into the observations that a lock-step run yields."""

from __future__ import annotations

import json
from collections import Counter
from heapq import merge
from itertools import pairwise
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

from benchmarks.faults.figures import false_figures
from benchmarks.faults.kinds import ENDING, Fault
from benchmarks.faults.log import Case, Log, Observed, Reaction, lost_between
from ltv_mpc.messages import Estimate, NodeStatus, Plan, RecordedStep, RejectedFrame, StepRecord, Truth
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.topics import BY_TYPE
from services.bus.wire import WireError
from services.recording.loss_accounting import LossAccounting, SequenceGaps
from services.recording.reader import Recording
from services.recording.writer import RunWriter

RECORDER, CONTROLLER, PLANT = "recorder", "controller", "plant"
ESTIMATE, PLAN, TRUTH = (BY_TYPE[kind].key for kind in (Estimate, Plan, Truth))

READ_BY = {"estimate": CONTROLLER, "applied": CONTROLLER, "plan": PLANT}
"""Reader of each key whose messages are harmed between processes."""

BACK_S = 2.0
"""Longest wall time from the end of a process to the first accepted message of its successor."""

OUTAGE_US = 60_000
"""Shortest gap in the recording that counts as an outage; the plant publishes every 5 ms at twice real time."""

MAX_OUTAGE_US = 10_000_000


class Injected(NamedTuple):
    """Injected fault of a run of processes."""

    fault: Fault
    at_ns: int  # vehicle time
    at_us: int = 0  # host's monotonic clock; for a full disk: when space was free again
    harmed: int = 0  # messages
    why: str = ""  # reason if the fault was not injected


class Ended(NamedTuple):
    """End of a run of processes: the injected faults, and how it ended if that was not to be.

    A run with a supervisor is ``summarised``; ``wait_s``: wall time from the signal that ended it to its end.
    """

    injected: list[Injected]
    uncontrolled: str
    summarised: bool = False
    wait_s: float | None = None


class Sent(NamedTuple):
    """Published message; ``at_us``: time of publication by the host's monotonic clock."""

    key: str
    epoch: int
    sequence: int
    at_us: int


def with_link(recording: Path, link: Path, out: Path) -> None:
    """Write a recording of both sides of the injector into ``out``: that of the run, and the one of the link.

    It has every frame that the node under test received or published, so that its replay finds them.
    """
    run, beyond = Recording(recording), Recording(link)
    messages = merge(run, beyond, key=attrgetter("t_ns"))
    first = next(messages)  # reading has begun: the metadata are known
    with RunWriter(out, start_ns=int(run.metadata["start_ns"]), metadata=run.metadata, flush_s=None) as writer:
        for stored in (first, *messages):
            if stored.kind is not None:
                writer.write_plain(stored.key, stored.kind, stored.plain, stored.t_ns, stored.crc)


class Recorded:
    """What a recording tells about a run of processes beyond its log."""

    def __init__(self, path: Path, vehicle: Vehicle) -> None:
        """Read a whole recording."""
        self.log = Log(vehicle)
        self.until_ns = 0
        self._sent: list[Sent] = []  # estimates, plans and truths
        self._taken: set[tuple[str, int, int]] = set()  # key, epoch and sequence of what plant and controller received
        self._statuses: list[NodeStatus] = []  # in order
        self._last: dict[int, NodeStatus] = {}  # last status by epoch, of nodes that have finished
        self._messages: Counter[int] = Counter()  # recorded, by epoch; one that is there twice is one
        self._unreadable = 0  # frames that cannot be decoded: harmed on the way, and rejected by their readers
        sources: dict[tuple[str, int], SequenceGaps] = {}
        steps: list[tuple[str, RecordedStep]] = []
        stamps: dict[tuple[int, int], int] = {}
        for stored in Recording(path):
            if stored.kind is None:
                continue
            try:
                message, header = stored.typed()
            except WireError:
                self._unreadable += 1
                continue
            self.until_ns = max(self.until_ns, stored.t_ns)
            if sources.setdefault((stored.key, header.epoch), SequenceGaps()).add(header.sequence):
                self._messages[header.epoch] += 1
            match message:
                case StepRecord() if message.node in (CONTROLLER, PLANT):
                    steps += [(message.node, step) for step in message.steps]
                case NodeStatus():
                    self._statuses.append(message)
                    if message.finished:
                        self._last[header.epoch] = message
                case Estimate() | Plan() | Truth():
                    self._sent.append(Sent(stored.key, header.epoch, header.sequence, header.sent_monotonic_us))
                    if isinstance(message, Estimate):
                        stamps[header.epoch, header.sequence] = message.t_ns
                case _:
                    pass
            node = message.node if isinstance(message, RejectedFrame) else CONTROLLER
            self.log.published(node, ReceivedMessage(message, header.epoch, header.sequence, stored.t_ns))
        for node, step in steps:
            self._taken.update((entry.key, entry.epoch, entry.sequence) for entry in step.inbox)
            if node == CONTROLLER:
                self.log.cycles.append(step.t_ns)
                self.log.received_estimates += [
                    (entry.received_t_ns, stamps[entry.epoch, entry.sequence])
                    for entry in step.inbox
                    if entry.key == ESTIMATE and (entry.epoch, entry.sequence) in stamps
                ]

    def lost(self, counted: int) -> int:
        """Count the messages that were published, of processes that report their number, are not recorded, and are
        counted neither in the recorder's last status nor in ``counted``.
        """
        lost = sum(max(0, status.published - self._messages[epoch]) for epoch, status in self._last.items())
        of_recorder = [status.dropped for status in self._statuses if status.node == RECORDER][-1:]
        return max(0, lost - max([counted, *of_recorder]) - self._unreadable)

    def dropped(self, node: str) -> list[tuple[int, int]]:
        """Return the number of messages that a reader counts as lost, over time."""
        return [(-(10**18), 0), *((one.t_ns, one.dropped) for one in self._statuses if one.node == node)]

    def holes(self, key: str) -> int:
        """Count the missing sequence numbers of a key between the first and the last recorded one of each epoch."""
        losses = LossAccounting(late=True)
        for epoch, sequence in sorted((sent.epoch, sent.sequence) for sent in self._sent if sent.key == key):
            losses.add(key, epoch, sequence)
        return losses.missing

    def back(self, one: Injected) -> Reaction | None:
        """Return the outage of a process that was killed or stopped for good; None for other faults."""
        if one.why:
            return Reaction(None, f"not injected: {one.why}")
        if one.fault.kind not in ENDING:
            return None
        if (at_us := self._again_us(one)) is None:
            return Reaction(None, "did not recover")
        seconds = (at_us - one.at_us) * 1e-6
        return Reaction(seconds, f"recovered after {seconds:.2f} s" if seconds > BACK_S else "")

    def _again_us(self, one: Injected) -> int | None:
        """Return when the process was back (monotonic, us).

        Estimator and controller: the first message of a new start that its reader took. Recorder and router: the
        plant's first word that is recorded again.
        """
        key = {"estimator": ESTIMATE, "controller": PLAN}.get(one.fault.target)
        if key is None:
            truth_us = sorted(sent.at_us for sent in self._sent if sent.key == TRUTH)
            ends = [b for a, b in pairwise(truth_us) if b - a > OUTAGE_US and b > one.at_us]
            if not truth_us or truth_us[-1] < one.at_us:
                return None
            return next((b for b in ends if b < one.at_us + MAX_OUTAGE_US), one.at_us)
        before = {sent.epoch for sent in self._sent if sent.key == key and sent.at_us <= one.at_us}
        after = (s for s in self._sent if s.key == key and s.at_us > one.at_us and s.epoch not in before)
        return next((sent.at_us for sent in after if (key, sent.epoch, sent.sequence) in self._taken), None)


def observe(folder: Path, vehicle: Vehicle, ended: Ended) -> tuple[Observed, list[Case]]:
    """Return the observations of a run of processes that has ended, and of its injected faults."""
    read = Recorded(folder / "run.mcap", vehicle)
    counted, false = 0, ""
    try:
        summary = json.loads((folder / "summary.json").read_text())
        counted = int(summary["messages"]["dropped"])
        false = "; ".join(false_figures(summary, read.log))
    except (OSError, ValueError, KeyError, TypeError) as error:  # a run that did not come to its end has none
        false = f"no summary: {error!r}" if ended.summarised else ""
    of = Observed(read.log, read.until_ns, ended.uncontrolled, false_figures=false, wait_s=ended.wait_s)
    cases = []
    for place, one in enumerate(ended.injected):
        end_ns, reader = max(one.at_ns, one.fault.end_ns), READ_BY.get(one.fault.target, "")
        case = Case(
            one.fault,
            one.at_ns,
            end_ns,
            of,
            harmed=one.harmed,
            counted=lost_between(read.dropped(reader), one.at_ns, end_ns),
            lost_plans=min(one.harmed, read.holes(PLAN)) if one.fault.target == PLAN else 0,
            back=read.back(one),
            lost=0 if place else read.lost(counted),
        )
        cases.append(case)
    return of, cases
