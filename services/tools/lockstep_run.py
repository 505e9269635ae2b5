"""A run in lock step: the nodes of a situation in this process, recorded and graded as they go."""

from __future__ import annotations

import gc
from collections.abc import Callable
from functools import cache

from ltv_mpc.control.node import ControllerNode
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.messages import Estimate, InboxEntry, Message, Rejected, StepRecord
from ltv_mpc.node import Arrival, Node
from services.bus import topics, wire
from services.bus.mailbox import Frame
from services.bus.message_validation import rejection
from services.recording.writer import RunWriter
from services.run.folder import RunFolder
from services.run.run_config import Situation
from services.run.summary import LOCKSTEP, summarise
from services.run.water import Learned
from sim.evaluation.metrics import Grader
from sim.evaluation.summary import Messages, Summary
from sim.plant import Plant
from sim.scheduler import EPOCH, LockStep, Step
from sim.sensors.node import Sensors

LATEST = frozenset(topic.message_type for topic in topics.TOPICS if topic.delivery is topics.LATEST)

PROGRESS_NS = 1_000_000_000
"""Vehicle time between two words about how far the run is."""


def nodes(situation: Situation, *, unheard: bool = True) -> list[Node]:
    """Every node of the situation, in the order of the launch table.

    ``unheard``: measure too what no node reads, for a recording.
    """
    scenario = situation.scenario
    plant = Plant(scenario, situation.vehicle, situation.water)
    aboard: list[Node] = [ControllerNode(situation.vehicle, situation.reference, scenario.controller)]
    if not scenario.run.perfect_state:  # else the sensors themselves write the estimate
        aboard.insert(0, Estimator(situation.suite, scenario.estimator, situation.prior))
    heard = None if unheard else frozenset(kind for node in aboard for kind in node.reads)
    return [plant, Sensors(scenario, situation.suite, situation.water, heard=heard), *aboard]


def run(
    situation: Situation,
    folder: RunFolder | None = None,
    *,
    progress: Callable[[int], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Summary:
    """The whole run, or as far as it came when ``stop`` was asked and said so.

    With a ``folder`` it is recorded, and its summary written beside what it learned of the water. ``progress`` is told
    the vehicle time.
    """
    if folder is None:
        return _go(situation, None, progress, stop)
    metadata = {"mode": LOCKSTEP, "seed": str(situation.scenario.run.seed), **situation.files}
    start_ns, learned = situation.scenario.start_ns, Learned()
    with RunWriter(folder.recording, start_ns=start_ns, metadata=metadata, flush_s=None) as writer:
        summary = _go(situation, writer, progress, stop, learned)
    folder.write_result(summary, learned.prior())
    return summary


def _go(
    situation: Situation,
    writer: RunWriter | None,
    progress: Callable[[int], None] | None,
    stop: Callable[[], bool],
    learned: Learned | None = None,
) -> Summary:
    """``learned`` hears what there is to be learned of the water."""
    _leave_alone()
    scenario = situation.scenario
    log = _Log(Grader(situation.vehicle), writer, learned)
    recorded = writer is not None
    lockstep = LockStep(
        nodes(situation, unheard=recorded),
        start_ns=scenario.start_ns,
        compute_delay_ns=round(scenario.run.compute_delay_s * 1e9),
        observe=log,
        heard=None if recorded else log.heard,
        stepped=log.stepped if recorded else None,
        latest=LATEST,
        refused=refused,
    )
    for t_ns in (*range(scenario.start_ns, scenario.end_ns, PROGRESS_NS), scenario.end_ns):
        if stop():
            break
        lockstep.advance(t_ns)
        if progress is not None:
            progress(t_ns)
    records = sum(lockstep.steps.values()) if recorded else 0
    messages = Messages(published=lockstep.published + records, dropped=0, rejected=log.rejected_count)
    return summarise(situation, log.grader, mode=LOCKSTEP, messages=messages)


@cache
def _leave_alone() -> None:
    """What lives when a process comes to its first run, modules above all, is not looked at again by any collection of
    cycles: a whole one took 60 ms, in every second run.
    """
    gc.collect()
    gc.freeze()


class _Log:
    """The run's observer: everything to the recording, if there is one, and to the grader."""

    def __init__(self, grader: Grader, writer: RunWriter | None, learned: Learned | None) -> None:
        self.grader = grader
        self.rejected_count = 0
        self._learned = learned
        self._writer = writer

    @property
    def heard(self) -> frozenset[type[Message]]:
        """Of which types it takes more than their number, without a recording."""
        return self.grader.hears | {Estimate, Rejected}

    def stepped(self, step: Step) -> None:
        assert self._writer is not None
        node, cause = step.node, step.cause
        record = StepRecord(
            node=node,
            epoch=EPOCH,
            step=step.number,
            t_ns=step.t_ns,
            cause=cause if isinstance(cause, str) else _key(step.inbox[-1].signal, node),
            inbox=tuple(_entry(message, node) for message in step.inbox),
        )
        self._writer.write(node, record, _header(step.number), step.at_ns)

    def published(self, node: str, message: Arrival) -> None:
        signal = message.signal
        self.grader.observe(signal, epoch=EPOCH, sequence=message.sequence, t_ns=message.received_t_ns)
        if type(signal) is Rejected:
            self.rejected_count += 1
        if self._writer is not None:
            self._writer.write(node, signal, _header(message.sequence), message.received_t_ns)
        if self._learned is not None and isinstance(signal, Estimate):
            self._learned.hear(signal)


def _header(sequence: int) -> wire.Header:
    return wire.Header(epoch=EPOCH, sequence=sequence, sent_monotonic_us=0)


def _entry(message: Arrival, reader: str) -> InboxEntry:
    """What the record keeps of an arrival: the crc is that of the frame which processes would have sent."""
    return InboxEntry(
        key=_key(message.signal, reader),
        epoch=message.epoch,
        sequence=message.sequence,
        crc=wire.crc(wire.encode(message.signal, _header(message.sequence))),
        received_t_ns=message.received_t_ns,
    )


def _key(signal: Message, reader: str) -> str:
    """On which key it came. Of the types that every node writes, a node reads only its own: ``Rejected``."""
    return topics.key_of(type(signal), reader)


def refused(node: str, message: Arrival, reason: str) -> Rejected:
    """As the door of a process words it."""
    signal = message.signal
    payload = wire.encode(signal, _header(message.sequence))
    frame = Frame(topics.BY_TYPE[type(signal)], _key(signal, node), payload, received_monotonic_us=0)
    return rejection(frame, reason, node=node, t_ns=message.received_t_ns)
