"""Lock-step run: all nodes of a run in this process, recorded and evaluated during the run."""

from __future__ import annotations

import contextlib
import errno
import gc
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import Any, TypeAlias

from ltv_mpc.messages import InboxEntry, Message, RecordedStep, RejectedFrame, StepRecord
from ltv_mpc.node import Node, ReceivedMessage
from services.bus import topics, wire
from services.bus.mailbox import Frame
from services.bus.message_validation import rejection
from services.recording.writer import RunWriter
from services.run.folder import DELETED, RunFolder
from services.run.nodes import make_nodes
from services.run.run_config import RunConfig
from services.run.summary import LOCKSTEP, STOPPED, metrics_of, summarise
from services.run.water import EstimatedCurrent
from sim.evaluation.metrics import RunMetrics
from sim.evaluation.summary import Messages, Summary
from sim.scheduler import EPOCH, LockStep, Observation, Step

PROGRESS_NS = 1_000_000_000
"""Vehicle time between two reports of progress."""

Progress: TypeAlias = Callable[[float, str], object]


class NotStored(OSError):
    """Failure to store a run: a full disk or a deleted folder. ``summary`` is that of the part that was simulated."""

    def __init__(self, error: OSError, summary: Summary) -> None:
        super().__init__(error.errno, error.strerror, error.filename)
        self.summary = summary


def run(
    run_config: RunConfig,
    folder: RunFolder | None = None,
    *,
    progress: Progress | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Summary:
    """Run all nodes in lock step, to the end of the run or until ``stop`` returns True.

    With a ``folder`` the recording, the summary and the estimated current are written there. ``progress`` receives the
    share done, and the vehicle time as text. Raises ``NotStored``.
    """
    if folder is None:
        return simulate(run_config, progress=progress, stop=stop)
    learned = EstimatedCurrent()

    def stop_or_deleted() -> bool:
        if folder.deleted:
            raise FileNotFoundError(errno.ENOENT, DELETED, str(folder.path))
        return stop()

    metadata = {"mode": LOCKSTEP, "seed": str(run_config.scenario.run.seed), **run_config.files}
    start_ns = run_config.scenario.start_ns
    with RunWriter(folder.recording, start_ns=start_ns, metadata=metadata, flush_s=None) as writer:
        try:
            summary = simulate(run_config, writer, progress=progress, stop=stop_or_deleted, keep=learned.update)
            writer.close()
            folder.write_result(summary, learned.prior())
        except NotStored:
            with contextlib.suppress(OSError):  # what the disk took is kept, without the end of the file
                writer.close()
            raise
        except OSError as error:
            raise NotStored(error, summary) from None
    return summary


def simulate(
    run_config: RunConfig,
    writer: RunWriter | None = None,
    *,
    progress: Progress | None = None,
    stop: Callable[[], bool] = lambda: False,
    nodes: Sequence[Node] | None = None,
    keep: Callable[[Message], None] | None = None,
) -> Summary:
    """Run all nodes in lock step without a folder.

    ``writer`` records, ``keep`` is called with each message, ``nodes`` replace those of the configuration.
    """
    _freeze_existing_objects()
    scenario = run_config.scenario
    log = _Log(metrics_of(run_config), writer, keep)
    recorded = writer is not None
    lockstep = LockStep(
        nodes or make_nodes(run_config, publish_unread_topics=recorded),
        start_ns=scenario.start_ns,
        compute_delay_ns=round(scenario.run.compute_delay_s * 1e9),
        observation=Observation(
            log,
            types=None if recorded or keep else log.metrics.message_types | {RejectedFrame},
            on_step=log.stepped if recorded else None,
        ),
        make_rejection=rejected_message,
    )
    failure: OSError | None = None
    why = STOPPED
    try:
        for t_ns in (*range(scenario.start_ns, scenario.end_ns, PROGRESS_NS), scenario.end_ns):
            if stop():
                break
            lockstep.advance(t_ns)
            if progress is not None:
                share = (t_ns - scenario.start_ns) / max(1, scenario.end_ns - scenario.start_ns)
                progress(share, f"t {t_ns / 1e9:z.1f} s")
        else:
            why = ""
    except OSError as error:
        failure, why = error, f"the run cannot be stored: {error.strerror}"
    records = sum(lockstep.steps.values()) if recorded else 0
    messages = Messages(published=lockstep.published + records, dropped=0, rejected=log.rejected_count)
    summary = summarise(run_config, log.metrics, mode=LOCKSTEP, messages=messages, why=why)
    if failure is not None:
        raise NotStored(failure, summary)
    return summary


@cache
def _freeze_existing_objects() -> None:
    """Exclude the objects that exist at the first run of a process from garbage collection, which becomes faster."""
    gc.collect()
    gc.freeze()


class _Log:
    """Observer of the run that passes messages to the recording, if there is one, and to the evaluation."""

    def __init__(self, metrics: RunMetrics, writer: RunWriter | None, keep: Callable[[Message], None] | None) -> None:
        self.metrics = metrics
        self.rejected_count = 0
        self._keep, self._writer = keep, writer

    def stepped(self, step: Step) -> None:
        """Record a step; only for a run with a writer."""
        assert self._writer is not None
        node, cause = step.node, step.cause
        cause = cause if isinstance(cause, str) else _key(step.inbox[-1].message, node)
        recorded = RecordedStep(t_ns=step.t_ns, cause=cause, inbox=tuple(_entry(one, node) for one in step.inbox))
        record = StepRecord(node=node, epoch=EPOCH, step=step.number, steps=(recorded,))
        self._writer.write(node, record, _header(step.number), step.at_ns)

    def published(self, node: str, message: ReceivedMessage) -> None:
        content = message.message
        self.metrics.observe(content, epoch=EPOCH, sequence=message.sequence)
        if type(content) is RejectedFrame:
            self.rejected_count += 1
        if self._writer is not None:
            plain, crc = _frame(message)
            self._writer.write_plain(_key(content, node), type(content), plain, message.received_t_ns, crc)
        if self._keep is not None:
            self._keep(content)


def _header(sequence: int) -> wire.Header:
    return wire.Header(epoch=EPOCH, sequence=sequence, sent_monotonic_us=0)


@lru_cache(maxsize=1000)  # a message is written, and soon after it is in the inboxes of its readers
def _frame(message: ReceivedMessage) -> tuple[dict[str, Any], int]:
    """Return the plain map of a message, and the crc of the frame that processes would have sent."""
    plain = wire.to_map(message.message, _header(message.sequence))
    return plain, wire.crc(wire.pack(plain))


def _entry(message: ReceivedMessage, reader: str) -> InboxEntry:
    """Return the inbox entry of a received message."""
    return InboxEntry(
        key=_key(message.message, reader),
        epoch=message.epoch,
        sequence=message.sequence,
        crc=_frame(message)[1],
        received_t_ns=message.received_t_ns,
    )


def _key(message: Message, reader: str) -> str:
    """Return the key of a message; that of a type that all nodes write ends with the name of the node."""
    return topics.key_of(type(message), reader)


def rejected_message(node: str, message: ReceivedMessage, reason: str) -> RejectedFrame:
    """Return the rejection message that a process would publish."""
    content = message.message
    payload = wire.encode(content, _header(message.sequence))
    frame = Frame(topics.BY_TYPE[type(content)], _key(content, node), payload, received_monotonic_us=0)
    return rejection(frame, reason, node=node, t_ns=message.received_t_ns)
