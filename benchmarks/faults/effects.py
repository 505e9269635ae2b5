"""Effects of faults outside the code under test: a failing solver, a restarted controller, another source of estimates.

A faulty solver wraps the controller's solver:
fails    reports a failure, with commands that are not finite
lies     reports "solved", with commands that are not finite, as some solvers do with NaN
raises   raises an exception, which no solver of this project does
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers import SolverFactory, make
from ltv_mpc.control.solvers.interface import Result, Solver
from ltv_mpc.messages import ControllerState, Estimate, Message, Pair, Plan, Solve, SolveStatus
from ltv_mpc.node import Inbox, Node, ReceivedMessage
from ltv_mpc.vehicle.reference_point import ReferencePoint

SECOND_EPOCH = 9
"""Epoch of the messages of a second source."""


class Interval(NamedTuple):
    """Half-open interval [start_ns, end_ns) of vehicle time in which a fault is active."""

    start_ns: int
    end_ns: int

    def contains(self, t_ns: int) -> bool:
        """Return True if ``t_ns`` lies in the interval."""
        return self.start_ns <= t_ns < self.end_ns


class NodeWrapper:
    """Node around another one: to the scheduler it looks like the node inside."""

    def __init__(self, node: Node) -> None:
        """Take name, schedule and message types of the node inside."""
        self._node = node
        self.name, self.schedule, self.reads, self.writes = node.name, node.schedule, node.reads, node.writes


class Antenna(NamedTuple):
    """Interval in which the estimates are those of an antenna that no vehicle file declares."""

    interval: Interval
    point: ReferencePoint

    def moved(self, received: ReceivedMessage) -> ReceivedMessage:
        """Return a message as measured at the antenna; all but estimates are unchanged."""
        estimate = received.message
        if not isinstance(estimate, Estimate) or not self.interval.contains(received.received_t_ns):
            return received
        # The origin lies as far from the antenna as the antenna from the origin, in the opposite direction.
        opposite = ReferencePoint(
            forward_m=-self.point.forward_m, starboard_m=-self.point.starboard_m, down_m=-self.point.down_m
        )
        return msgspec.structs.replace(received, message=opposite.to_origin(estimate))


class SecondSource(NamedTuple):
    """Interval in which a second source publishes beside each estimate, and by how far its position is off."""

    interval: Interval
    offset_m: Pair  # north, east

    def message(self, received: ReceivedMessage) -> ReceivedMessage | None:
        """Return what it publishes beside a message; None outside the interval, and for all but estimates."""
        estimate = received.message
        if not isinstance(estimate, Estimate) or not self.interval.contains(received.received_t_ns):
            return None
        north_m, east_m = self.offset_m
        moved = msgspec.structs.replace(estimate, north_m=estimate.north_m + north_m, east_m=estimate.east_m + east_m)
        return msgspec.structs.replace(received, message=moved, epoch=SECOND_EPOCH)


class RestartedNode(NodeWrapper):
    """Controller that dies in intervals; after each a new one continues from the state that it published last."""

    def __init__(self, make: Callable[[], Node], intervals: Sequence[Interval]) -> None:
        """Begin with the first node that ``make`` returns."""
        super().__init__(make())
        self._make = make
        self._intervals = intervals
        self._dead = False
        self._state: ControllerState | None = None
        self._plan: Plan | None = None  # in force

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        """Step the node inside; a dead one publishes nothing and loses its inbox."""
        if any(interval.contains(t_ns) for interval in self._intervals):
            self._dead = True
            return []
        if self._dead:
            self._node, self._dead = self._make(), False
            if self._state is not None:
                state = msgspec.structs.replace(self._state, plan=self._plan)
                inbox = [ReceivedMessage(state, 0, 0, t_ns), *inbox]
        outputs = self._node.step(t_ns, inbox)
        for message in outputs:
            if isinstance(message, ControllerState):
                self._state = message
            elif isinstance(message, Plan):
                self._plan = message
        return outputs


class SolverFault(enum.StrEnum):
    """Behaviour of a faulty solver."""

    FAILS = "fails"
    LIES = "lies"
    RAISES = "raises"


class SolverFaultInterval(NamedTuple):
    """Solver fault and the interval in which it is active."""

    fault: SolverFault
    interval: Interval


class InjectedSolverError(RuntimeError):
    """Exception that a faulty solver raises."""


class SolverClock:
    """Vehicle time of the controller's cycle, by which a faulty solver knows whether a fault is active."""

    def __init__(self) -> None:
        self.t_ns = 0


class FaultySolver:
    """Wrapper of a solver that fails while a fault is active."""

    def __init__(self, solver: Solver, faults: Sequence[SolverFaultInterval], now: SolverClock) -> None:
        self._solver = solver
        self._faults = faults
        self._now = now

    def __getattr__(self, name: str) -> Any:
        return getattr(self._solver, name)

    def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:
        """Return the solver's result, or that of the active fault."""
        answer = self._solver.solve(problem, shift, last=last)
        for fault, interval in self._faults:
            if not interval.contains(self._now.t_ns):
                continue
            if fault is SolverFault.RAISES:
                raise InjectedSolverError("injected fault")
            status = SolveStatus.SOLVED if fault is SolverFault.LIES else SolveStatus.FAILED
            return Result(np.full_like(answer.z, math.nan), Solve(status=status, why=f"it {fault}"))
        return answer


class TimedNode(NodeWrapper):
    """Node that sets a solver clock to the time of each of its steps."""

    def __init__(self, node: Node, now: SolverClock) -> None:
        super().__init__(node)
        self._now = now

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        """Step the node inside."""
        self._now.t_ns = t_ns
        return self._node.step(t_ns, inbox)


def faulty_solvers(faults: Sequence[SolverFaultInterval], now: SolverClock) -> SolverFactory:
    """Return a solver factory for a controller whose solvers have these faults."""
    return lambda vehicle, config: FaultySolver(make(vehicle, config), faults, now)
