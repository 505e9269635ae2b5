"""Recording of a run of processes, read into the observations that a lock-step run yields."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import NamedTuple

from ltv_mpc.messages import Estimate, NodeStatus, Plan, RecordedStep, RejectedFrame, StepRecord, Truth
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.topics import BY_TYPE
from services.bus.wire import WireError
from services.recording.reader import Recording
from services.recording.sequence_gaps import SequenceGaps
from services.tools.faults.lockstep_runs import Log

CONTROLLER, PLANT = "controller", "plant"
ESTIMATE, PLAN, TRUTH = (BY_TYPE[kind].key for kind in (Estimate, Plan, Truth))


class Taken(NamedTuple):
    """Message in the inbox of a recorded step."""

    key: str
    epoch: int
    sequence: int


class Sent(NamedTuple):
    """Published message; ``at_us``: time of publication by the host's monotonic clock."""

    key: str
    epoch: int
    sequence: int
    at_us: int


class Recorded(NamedTuple):
    """Observations of one run of processes, from its recording."""

    log: Log
    taken: frozenset[Taken]  # by plant and controller
    sent: list[Sent]  # estimates, plans and truths
    statuses: list[NodeStatus]  # all of them, in order
    last: dict[int, NodeStatus]  # last status by epoch, of nodes that have finished
    messages: Counter[int]  # recorded, by epoch; one that is there twice is one
    unreadable: int  # recorded frames that cannot be decoded: harmed on the way, and rejected by their readers
    until_ns: int


def read(path: Path, vehicle: Vehicle) -> Recorded:
    """Read a whole recording."""
    log = Log(vehicle)
    sent: list[Sent] = []
    statuses: list[NodeStatus] = []
    last: dict[int, NodeStatus] = {}
    messages: Counter[int] = Counter()
    sources: dict[tuple[str, int], SequenceGaps] = {}
    steps: list[tuple[str, RecordedStep]] = []
    stamps: dict[tuple[int, int], int] = {}
    until_ns = unreadable = 0
    for stored in Recording(path):
        if stored.kind is None:
            continue
        try:
            message, header = stored.typed()
        except WireError:
            unreadable += 1
            continue
        key, t_ns = stored.key, stored.t_ns
        until_ns = max(until_ns, t_ns)
        if sources.setdefault((key, header.epoch), SequenceGaps()).add(header.sequence):
            messages[header.epoch] += 1
        match message:
            case StepRecord() if message.node in (CONTROLLER, PLANT):
                steps += [(message.node, step) for step in message.steps]
            case NodeStatus():
                statuses.append(message)
                if message.finished:
                    last[header.epoch] = message
            case Estimate() | Plan() | Truth():
                sent.append(Sent(key, header.epoch, header.sequence, header.sent_monotonic_us))
                if isinstance(message, Estimate):
                    stamps[header.epoch, header.sequence] = message.t_ns
            case _:
                pass
        node = message.node if isinstance(message, RejectedFrame) else CONTROLLER
        log.published(node, ReceivedMessage(message, header.epoch, header.sequence, t_ns))
    for node, step in steps:
        if node == CONTROLLER:
            log.cycles.append(step.t_ns)
            log.received_estimates += [
                (entry.received_t_ns, stamps[entry.epoch, entry.sequence])
                for entry in step.inbox
                if entry.key == ESTIMATE and (entry.epoch, entry.sequence) in stamps
            ]
    taken = frozenset(Taken(entry.key, entry.epoch, entry.sequence) for _, step in steps for entry in step.inbox)
    return Recorded(log, taken, sent, statuses, last, messages, unreadable, until_ns)
