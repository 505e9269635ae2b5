"""Solver faults: a wrapper around the controller's solver that fails during given intervals.

fails    reports a failure, with commands that are not finite
lies     reports "solved", with commands that are not finite, as some solvers do with NaN
raises   raises an exception, which no solver of this project does
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ltv_mpc.control.solvers import SolverFactory, make
from ltv_mpc.control.solvers.interface import Result, Solver
from ltv_mpc.messages import Message, Solve, SolveStatus
from ltv_mpc.node import Inbox, Node
from sim.faults.interval import Interval
from sim.faults.node_wrapper import NodeWrapper


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

    def solve(self) -> Result:
        """Return the solver's result, or that of the active fault."""
        answer = self._solver.solve()
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
