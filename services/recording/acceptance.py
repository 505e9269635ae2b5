"""Acceptance: whether a recorded message counts, by the checks that its readers made.

    content   decoded and validated as by every reader; on a key of every node the message names the node of its key
    order     epoch and sequence number (``SequenceCheck``), and one start of each process at a time
    choice    estimates of the source that the controller uses, if its gate accepts them, and plans of the controller
              that the actuators follow

Recorder, summary and report count by it, so that a frame of a stranger changes no figure but the number of rejections.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple

from ltv_mpc.bounded import remember
from ltv_mpc.messages import Applied, Clock, ControllerStatus, Estimate, Message, NodeStatus, Plan
from ltv_mpc.safety.input_age import InputMonitor
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.message_validation import SHARED
from services.bus.roles import ANYONE, DISPLAY, ROLES
from services.bus.sequence_check import FAR_AHEAD, SECOND_SOURCE, SequenceCheck, silence_us
from services.bus.topics import OPERATOR, Topic, topic_at
from services.bus.wire import Header, WireError, message_at
from services.recording.loss_accounting import LossAccounting
from services.recording.reader import StoredMessage

if TYPE_CHECKING:
    from ltv_mpc.safety.estimate_gate import EstimateGate

NODES = frozenset(ROLES) - {DISPLAY, OPERATOR}
"""Names whose messages count on the keys of every node: what others publish there nobody reads, lost or not."""

MAX_HELD = 32
"""Plans of other controllers that are kept until the actuators follow one of them."""

LATE = "late"
"""Reason of a refused message that was missing until it came: it was published, and is not lost."""

MANY_SOURCES = (ANYONE, OPERATOR)
"""Writers of the table that stand for several sources."""


class Accepted(NamedTuple):
    """Accepted message with its header and its vehicle time of publication."""

    message: Message
    header: Header
    t_ns: int


class Acceptance:
    """Decision for each message of one run, in the order of the recording, with the losses and the rejections.

    ``vehicle`` decides which estimates are plausible; None: all. ``speed``: of the clock until its first message.
    ``late``: as of ``LossAccounting``.
    """

    def __init__(self, vehicle: Vehicle | None = None, *, speed: float = 1.0, late: bool = False) -> None:
        self.losses = LossAccounting(late=late)
        self.rejected = 0
        self.source_epoch = 0
        """Epoch of the estimates in use; 0: unknown."""
        self._order = SequenceCheck()
        self._unconfirmed: dict[tuple[str, int], tuple[int, Accepted | None]] = {}  # first ones behind a gap
        self._writers: dict[str, tuple[int, int]] = {}  # epoch and newest message (us) of each process
        self._gate: EstimateGate | None = None
        if vehicle is not None:
            from ltv_mpc.safety.estimate_gate import EstimateGate  # numba: 20 MB that a recorder does not need

            self._gate = EstimateGate(vehicle)
        self._monitor = InputMonitor()
        self._commander = 0  # epoch of the controller whose plans are followed; 0: unknown
        self._held: deque[Accepted] = deque(maxlen=MAX_HELD)
        self._speed = speed
        self._wall_us, self._newest_ns = 0.0, 0

    def count(self, topic: Topic, key: str, header: Header, received_us: int) -> str:
        """Check the order of a message and count it. Return why it is refused; empty if it is accepted."""
        (epoch, sequence), kind = (header.epoch, header.sequence), topic.message_type
        node = key.rpartition("/")[2]
        writer = node if kind is NodeStatus else topic.written_by
        single = kind not in SHARED and writer not in MANY_SOURCES
        if single:
            active, at_us = self._writers.get(writer, (epoch, 0))
            if active != epoch and received_us - at_us < silence_us(topic.period_ns):
                return f"{SECOND_SOURCE}: epoch {epoch} while epoch {active} publishes"
        try:
            self._order.check(f"{key}@{epoch}", header, received_us)
        except WireError as error:
            return LATE if self.losses.fill(key, epoch, sequence) else str(error)
        if single:
            self._writers[writer] = epoch, received_us
        if topic.written_by == ANYONE and node not in NODES:
            return ""
        # Of a source that is not in use, or not of the process of its name, nothing is missing. Before its first status
        # a process counts while nothing of it is missing.
        in_use = {Estimate: self.source_epoch or epoch, Plan: self._commander or epoch}
        of_process = epoch if single else self._writers.get(node, (0, 0))[0]
        counts = in_use.get(kind, of_process) == epoch or (
            not of_process and self.losses.is_whole(key, epoch, sequence)
        )
        self.losses.add(key, epoch, sequence, counts=counts)
        return ""

    def take(
        self,
        stored: StoredMessage,
        kinds: Collection[type[Message]],
        wanted: Callable[[StoredMessage, Header], bool] | None = None,
    ) -> Iterator[Accepted]:
        """Yield what is accepted with a message: itself, if its type is one of ``kinds``, after plans that had waited.

        Of a message that is not ``wanted`` the content is not decoded.
        """
        topic, t_ns = topic_at(stored.key), stored.t_ns
        self._wall_us += max(0, t_ns - self._newest_ns) / 1e3 / self._speed
        self._newest_ns = max(t_ns, self._newest_ns)
        message = None
        try:
            if topic is None:
                raise WireError("unknown key")
            header = stored.header() if wanted is not None or topic.message_type not in kinds else None
            if topic.message_type in kinds and (header is None or wanted is None or wanted(stored, header)):
                message, header = message_at(topic, stored.key, stored.plain)
            assert header is not None
        except WireError:
            self.rejected += 1
            return
        refused = self.count(topic, stored.key, header, int(self._wall_us))
        source = stored.key, header.epoch
        if refused:  # a process that was started again is no fault of its statuses
            self.rejected += refused is not LATE and topic.message_type is not NodeStatus
            if refused.startswith(FAR_AHEAD):
                waits = None if message is None else Accepted(message, header, t_ns)
                remember(self._unconfirmed, source, (header.sequence, waits))
            return
        before = self._unconfirmed.pop(source, None)
        if before is not None and before[0] < header.sequence:  # a gap, behind which it was the first message
            self.rejected -= topic.message_type is not NodeStatus
            if before[1] is not None:
                yield from self._chosen(before[1])
        if message is not None:
            yield from self._chosen(Accepted(message, header, t_ns))

    def _chosen(self, accepted: Accepted) -> Iterator[Accepted]:
        """Yield a message in order, unless it is of a source that is not in use."""
        message, header, t_ns = accepted
        match message:
            case Clock():
                self._speed = max(message.speed_num / message.speed_den, 1e-3)
            case ControllerStatus() if message.source_epoch not in (0, self.source_epoch):
                self.source_epoch, self._monitor = message.source_epoch, InputMonitor()
                if self._gate is not None:
                    self._gate.restart()
            case Estimate():
                if header.epoch != (self.source_epoch or header.epoch) or not self._is_plausible(message, header, t_ns):
                    self.rejected += 1
                    return
                self.source_epoch = header.epoch
            case Plan():
                self._commander = self._commander or header.epoch
                if header.epoch != self._commander:
                    self.rejected += 1
                    self._held.append(accepted)
                    return
            case Applied() if message.plan_sequence >= 0 and message.plan_epoch != self._commander:
                self._commander = message.plan_epoch
                waited = [plan for plan in self._held if plan.header.epoch == self._commander]
                self._held.clear()
                self.rejected -= len(waited)
                yield from waited
        yield accepted

    def _is_plausible(self, estimate: Estimate, header: Header, t_ns: int) -> bool:
        """Return True if the controller would use this estimate of its source."""
        stamp_ns = estimate.t_ns
        if not self._monitor.receive(epoch=header.epoch, sequence=header.sequence, stamp_ns=stamp_ns, received_ns=t_ns):
            return False
        return self._gate is None or not self._gate.check(estimate)


def accepted(recording: Iterable[StoredMessage], kinds: Collection[type[Message]]) -> Iterator[Accepted]:
    """Yield the accepted messages of these types."""
    acceptance = Acceptance()
    deciding: set[type[Message]] = {*kinds, Applied, Clock, ControllerStatus}
    for stored in recording:
        yield from (one for one in acceptance.take(stored, deciding) if type(one.message) in kinds)
