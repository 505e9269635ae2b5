"""Figures of a summary, compared with what the run's own messages say: in lock step all, between processes the main.

In lock step ``Witness`` evaluates what the nodes published, and records it with the frames that a role adds on its own
keys. Each figure of the recording's summary must be that of the nodes' messages.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from benchmarks.faults import world
from benchmarks.faults.effects import Interval
from benchmarks.faults.judge import errors
from benchmarks.faults.log import INTRUDERS_EPOCH, Log
from ltv_mpc.messages import LocalisationReport, Message, NodeStatus, RejectedFrame, RunEvent
from ltv_mpc.node import ReceivedMessage
from services.bus import wire
from services.recording.writer import RunWriter
from services.run.run_config import RunConfig
from services.run.summary import SERVICES, metrics_of, summarise, summarise_recording
from sim.evaluation.summary import Messages

FAR = 2**40
"""Sequence number that no source reaches."""

MAX_EPOCH = 2**48
OFFSET = 75.0
"""What a false message adds to each of its numbers."""

EXACT = 1e-6
"""Relative tolerance of figures that are computed twice."""


class OwnKeys(NamedTuple):
    """Interval in which a role publishes false frames beside a share of its messages of these types.

    Their headers have a sequence number that nobody reaches, an old one, or the epoch of another start.
    """

    kinds: tuple[type[Message], ...]
    interval: Interval
    share: float
    seed: int

    def frames(self, message: ReceivedMessage) -> list[ReceivedMessage]:
        """Return what is published beside a message: the same for every reader."""
        rng = np.random.default_rng([self.seed, message.sequence])
        concerned = type(message.message) in self.kinds and self.interval.contains(message.received_t_ns)
        if not concerned or rng.random() >= self.share:
            return []
        another, far = int(rng.integers(10, MAX_EPOCH)), FAR + int(rng.integers(FAR))
        old = int(rng.integers(message.sequence + 1))
        headers = (message.epoch, far), (message.epoch, old), (another, far), (another, 0)
        epoch, sequence = headers[int(rng.integers(len(headers)))]
        return [msgspec.structs.replace(message, message=_false(message.message), epoch=epoch, sequence=sequence)]


def _false(message: Message) -> Message:
    """Return a message with an offset in each of its real numbers."""
    changed: dict[str, Any] = {}
    for name in message.__struct_fields__:
        value = getattr(message, name)
        if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
            changed[name] = value + OFFSET
        elif isinstance(value, tuple) and value and isinstance(value[0], float):
            changed[name] = tuple(one + OFFSET for one in value)
    return msgspec.structs.replace(message, **changed)


COUNTS = dict.fromkeys(("steps", "published", "received", "dropped", "rejected"), FAR)
STATUS = NodeStatus(node="sensors", t_ns=0, ready=True, waiting_for="", **COUNTS)
REJECTED = RejectedFrame(t_ns=0, node="sensors", key="plan", reason="false", crc=0, payload_base64="")
REPORTS: Sequence[tuple[str, Message]] = (
    ("status/x", STATUS),
    ("event/x", RunEvent(t_ns=0, node="supervisor", kind="fault", text="false")),
    ("event/x", RunEvent(t_ns=0, node="supervisor", kind="ended", text="false")),
    ("rejected/x", REJECTED),
)
"""Reports under another name than that of their key."""


class Witness:
    """Observer of a run that records its messages with the false frames beside them, and evaluates them alone."""

    def __init__(self, log: Log, of: RunConfig, path: Path, own_keys: Sequence[OwnKeys]) -> None:
        self._log, self._of, self._own_keys = log, of, own_keys
        self._metrics = metrics_of(of)
        self._writer = RunWriter(path, start_ns=of.scenario.start_ns, metadata={}, flush_s=None)
        self.sent: Counter[OwnKeys] = Counter()
        """Number of false frames of each fault."""
        self._published = self._rejected = 0

    def published(self, node: str, message: ReceivedMessage) -> None:
        """Evaluate a message, and record it."""
        self._log.published(node, message)
        if node == world.INTRUDER:
            message = msgspec.structs.replace(message, epoch=INTRUDERS_EPOCH)
        else:
            self._metrics.observe(message.message, epoch=message.epoch, sequence=message.sequence)
            self._published += 1
        self._rejected += node == world.INTRUDER or isinstance(message.message, RejectedFrame)
        self._write(node, message)
        for own in self._own_keys:
            for frame in own.frames(message):
                self._write(node, frame)
                self.sent[own] += 1
                if isinstance(frame.message, LocalisationReport):
                    for key, report in REPORTS:
                        plain = wire.to_map(report, wire.Header(epoch=frame.epoch, sequence=frame.sequence))
                        self._writer.write_plain(key, type(report), plain, frame.received_t_ns)
                        self._writer.write_plain(key, type(report), {"epoch": 5, "sequence": 0}, frame.received_t_ns)
                        self.sent[own] += 2

    def _write(self, node: str, message: ReceivedMessage) -> None:
        header = wire.Header(epoch=message.epoch, sequence=message.sequence)
        self._writer.write(node, message.message, header, message.received_t_ns)

    def false_figures(self) -> str:
        """Name each figure of the recording's summary that differs from the nodes' messages; empty: none."""
        self._writer.close()
        made = summarise_recording(self._of, self._writer.path)[0]
        rejected = min(made.messages.rejected, self._rejected + self.sent.total())
        messages = Messages(published=self._published, dropped=0, rejected=rejected)
        true = summarise(self._of, self._metrics, mode=SERVICES, messages=messages)
        fields = made.__struct_fields__
        wrong = [
            f"{name} {getattr(made, name)} instead of {getattr(true, name)}"
            for name in fields
            if getattr(made, name) != getattr(true, name)
        ]
        return "; ".join([*wrong, *false_figures(msgspec.to_builtins(made), self._log)])


def false_figures(summary: Mapping[str, Any], log: Log) -> list[str]:
    """Name the figures of a summary that differ from those computed here, from the plant's truth among others."""
    of = errors(log)
    true_m = np.hypot(*of.true_m.T)
    *_, refused, late = log.applied[-1] if log.applied else (0, 0)
    figures = {
        name: (summary[name], true)
        for name, true in (("cycles", len(log.plans)), ("deadline_misses", late), ("plans_refused", refused))
    }
    for name, values in (("tracking_error_m", of.tracking_m), ("true_error_drift_m", true_m)):
        for what, true in (("mean", values.mean()), ("max", values.max())) if len(values) else ():
            figures[f"{name} {what}"] = summary[name][what], float(true)
    return [
        f"{name} {said} instead of {true}"
        for name, (said, true) in figures.items()
        if said is None or abs(said - true) > EXACT * max(1.0, abs(true))
    ]
