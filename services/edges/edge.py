"""Interface of all edges: what every converter to another system does in the same way.

Frames   World NED and body FRD on this side. An edge converts in the function that reads or writes a foreign message.
Units    SI and radians on this side, thrusts in N in the order port, starboard, vertical.
Time     Vehicle time is the clock of the foreign stamps. ``StampedClock`` reads it at an instant of the host.
Refusal  A foreign frame becomes messages, or it is refused with a reason. Both are counted; no frame raises.
Status   ``accepted``, ``lost`` and ``refused``, which the process publishes as its ``NodeStatus``.

An edge is a pure step, as a node is: the caller passes ``now_us``, the monotonic time of the host, and sends what
the edge returns. ``docs/edges.md`` builds an edge with it.
"""

from __future__ import annotations

import abc
from collections import deque
from collections.abc import Iterable
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np

from ltv_mpc.messages import Applied, Array, Estimate, Message, Plan
from ltv_mpc.safety.plan_queue import PlanQueue
from ltv_mpc.validation import ReasonCounts, rejection_reason
from ltv_mpc.vehicle.parameters import PLAN_TIMEOUT_S, Vehicle

WINDOW_US = 30_000_000
MAX_ROUND_TRIP_US = 1_000_000
MAX_STAMP_NS = 2_147_000_000 * 10**9
"""Largest stamp: 2038, some days before the seconds of ROS 2, which have 32 bits, end."""

MAX_AHEAD_NS, AHEAD_US = 2 * 10**9, 1_000_000
"""A stamp further ahead of the clock is wrong, until stamps have stayed ahead for this time: the clock was set."""

REPORT_NS = 100_000_000
"""Time between two reports of what acts."""

MAX_SENDERS = 100
"""Largest number of senders whose losses are counted."""


class Refused(ValueError):
    """Foreign frame that cannot be used; the text is the reason."""


class Received(NamedTuple):
    """Foreign frame: the channel on which it arrived, its bytes, what the transport added to it, and its arrival."""

    channel: str
    payload: bytes
    attachment: bytes
    now_us: int


class Outgoing(NamedTuple):
    """Foreign frame to send on a channel."""

    channel: str
    payload: bytes


Output: TypeAlias = Message | Outgoing
"""What an edge returns: a message for this bus, or a frame for the other side."""


class StampedClock:
    """Clock of foreign stamps, from the least delayed message of the last 30 s.

        time = monotonic + max (stamp - arrival)

    It is slow by the delay of that message: a fraction of a millisecond on one host.
    """

    def __init__(self) -> None:
        self._best: deque[tuple[int, int]] = deque()  # arrival (us), stamp - arrival (ns); decreasing
        self._fastest_us = MAX_ROUND_TRIP_US
        self._ahead_us: int | None = None  # since when stamps are ahead

    def update(self, stamp_ns: int, now_us: int) -> None:
        """Add a message that arrived at ``now_us`` with this stamp. Raises ``Refused`` for a stamp that is wrong."""
        if not 0 <= stamp_ns <= MAX_STAMP_NS:
            raise Refused(f"stamp = {stamp_ns / 1e9:.9g} s: must be from 0 to {MAX_STAMP_NS / 1e9:.0f}")
        offset_ns = stamp_ns - now_us * 1000
        if self._best and (ahead_ns := offset_ns - self._best[0][1]) > MAX_AHEAD_NS:
            self._ahead_us = now_us if self._ahead_us is None else self._ahead_us
            if now_us < self._ahead_us + AHEAD_US:
                raise Refused(f"stamp = {stamp_ns / 1e9:.9g} s: {ahead_ns / 1e9:.3g} s ahead of the stamps before it")
        self._ahead_us = None
        while self._best and self._best[-1][1] <= offset_ns:
            self._best.pop()
        self._best.append((now_us, offset_ns))
        while self._best[0][0] < now_us - WINDOW_US:
            self._best.popleft()

    def exchange(self, theirs_ns: int, sent_us: int, now_us: int) -> None:
        """Add the answer to a request: their time, half the round trip ago, if it was among the fastest."""
        round_trip_us = now_us - sent_us
        if 0 <= round_trip_us <= min(2 * self._fastest_us, MAX_ROUND_TRIP_US):
            self._fastest_us = min(self._fastest_us, round_trip_us)
            self.update(theirs_ns + 500 * round_trip_us, now_us)

    def read(self, now_us: int) -> int | None:
        """Return the time (ns) at ``now_us``; None before the first message."""
        return now_us * 1000 + self._best[0][1] if self._best else None

    def reset(self) -> None:
        """Forget all stamps: the foreign clock has restarted."""
        self._best.clear()
        self._ahead_us = None


class Edge(abc.ABC):
    """Converter between this bus and another system. A subclass names what it reads and writes, and converts."""

    name: ClassVar[str]
    reads: ClassVar[tuple[type[Message], ...]]
    """Types of this bus that ``take`` handles."""
    writes: ClassVar[tuple[type[Message], ...]]
    """Types of this bus that the edge returns."""

    def __init__(self, epoch: int) -> None:
        """``epoch``: random number of this start, from which the identifiers of commands are counted."""
        self.clock = StampedClock()
        self.plans = PlanQueue(PLAN_TIMEOUT_S)
        self.accepted = 0  # foreign frames
        self.lost = 0  # foreign frames that were sent and have not arrived, as far as their numbers show
        self.refused_by_reason = ReasonCounts()
        self.reason = ""  # of the last refusal
        self.idle = ""
        """Why the edge does not drive, a sentence; empty if it does."""
        self._command_id = epoch

    @property
    def refused(self) -> int:
        """Number of refused foreign frames."""
        return self.refused_by_reason.total()

    @property
    def waiting_for(self) -> str:
        """Input that the edge needs before it can do its work; empty if it needs none."""
        return "" if self.accepted else "estimates"

    def receive(self, frame: Received) -> list[Output]:
        """Convert a foreign frame. A frame that cannot be used is counted, and nothing is returned."""
        outputs: list[Output] = []
        try:
            for output in self.convert(frame):
                if not isinstance(output, Outgoing) and (reason := rejection_reason(output)) is not None:
                    raise Refused(reason)
                if isinstance(output, Estimate):
                    self.clock.update(output.t_ns, frame.now_us)
                outputs.append(output)
        except Refused as refusal:
            self.refuse(refusal)
            return []
        self.accepted += 1
        return outputs

    def refuse(self, refusal: Refused) -> None:
        """Count a refused foreign frame."""
        self.reason = str(refusal)
        self.refused_by_reason.add(self.reason)

    def command_id(self) -> int:
        """Return a new identifier for a ``Command``."""
        self._command_id += 1
        return self._command_id

    def take(self, message: Message, now_us: int, identity: tuple[int, int] = (0, -1)) -> Iterable[Output]:
        """Handle a message of this bus, of a type in ``reads``, with the epoch and the sequence of its header."""
        if isinstance(message, Plan) and (t_ns := self.clock.read(now_us)) is not None:
            self.plans.add(message, t_ns, identity)
        return ()

    @abc.abstractmethod
    def convert(self, frame: Received) -> Iterable[Output]:
        """Convert a foreign frame. Raises ``Refused``, and nothing else.

        The validity of an output is checked when it is yielded: what follows a ``yield`` happens to accepted ones only.
        """

    @abc.abstractmethod
    def step(self, now_us: int) -> Iterable[Output]:
        """Return what is due in this period, the thrusts above all."""

    @abc.abstractmethod
    def release(self, now_us: int) -> Iterable[Output]:
        """Return the last frames, after which the edge sends nothing: the thrusters stop."""


class AppliedReporter:
    """Reports of the commands of an edge, every 0.1 s, from its first plan on.

    Thrust is delivered, from rest, of the commands u since the last report, which are zero while the edge has released
    the thrusters:

        F_i += (1 - exp(-dt / lag_i)) (u_i - F_i)

    The controller then plans from what acts, and learns nothing while the commands are not those of its plans.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._lag_s = np.array([max(thruster.lag_s, 1e-9) for thruster in vehicle.thrusters])
        self._thrust_N, self._command_N = np.zeros(3), np.zeros(3)
        self._t_ns = self._reported_ns = 0
        self._released = True

    def report(self, plans: PlanQueue, command_N: Array | None, t_ns: int | None, why: str = "") -> list[Applied]:
        """Take the command from ``t_ns`` on, None for released thrusters, and why. Return the report if it is due.

        It is due at once when the thrusters are released.
        """
        if t_ns is None or plans.newest is None:
            return []
        seconds = max(t_ns - self._t_ns, 0) * 1e-9
        self._thrust_N += (1.0 - np.exp(-seconds / self._lag_s)) * (self._command_N - self._thrust_N)
        self._command_N, self._t_ns = np.zeros(3) if command_N is None else np.asarray(command_N, dtype=float), t_ns
        released, self._released = self._released, command_N is None
        if 0 <= t_ns - self._reported_ns < REPORT_NS and released >= self._released:
            return []
        self._reported_ns = t_ns
        return [plans.applied(t_ns, self._thrust_N, self._command_N, why=why)]


class LossCounter:
    """Count of the lost frames of each sender, from the numbers that it gives to its frames.

    A frame that arrives late was counted as lost and is no longer. A large step is a restart of the sender.
    """

    def __init__(self, modulus: int = 1 << 63) -> None:
        """``modulus``: the numbers begin again at 0 when they reach it."""
        self.lost = 0
        self._modulus = modulus
        self._limit = min(modulus // 2, 1000)  # largest step that counts as loss
        self._newest: dict[object, int] = {}  # counted on where the numbers begin again
        self._missing: dict[object, deque[int]] = {}

    def add(self, sender: object, number: int) -> bool:
        """Add a received frame. Return False if it is a duplicate."""
        if sender not in self._newest:
            if len(self._newest) < MAX_SENDERS:  # more are senders that nobody expects
                self._newest[sender], self._missing[sender] = number, deque(maxlen=self._limit // 2)
            return True
        newest, missing = self._newest[sender], self._missing[sender]
        half = self._modulus // 2
        step = (number - newest + half) % self._modulus - half
        at = newest + step
        if abs(step) > self._limit:
            missing.clear()
        elif step > 0:
            missing.extend(range(newest + 1, at))
            self.lost += step - 1
        else:
            if at not in missing:
                return False
            missing.remove(at)
            self.lost -= 1
            return True
        self._newest[sender] = at
        return True
