"""A solver in trouble: it stands around the controller's own, and for a while gives no answer, or a bad one.

fails    says so, with commands that are not finite
lies     says "solved", with commands that are not finite: what some solvers do with NaN
raises   an exception, which no solver of this project does
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from ltv_mpc.control import controller
from ltv_mpc.control.solvers.interface import Solver, SolverResult
from ltv_mpc.messages import Message, Solve, SolveStatus
from ltv_mpc.node import Due, Node, Schedule
from sim.faults.interval import Interval


class SolverFault(enum.StrEnum):
    """What a solver does."""

    FAILS = "fails"
    LIES = "lies"
    RAISES = "raises"


class SolverFaultInterval(NamedTuple):
    """One spell of trouble."""

    fault: SolverFault
    interval: Interval


class InjectedSolverError(RuntimeError):
    """What a solver in trouble raises."""


class SolverClock:
    """The time that a solver in trouble goes by: that of its controller's cycle."""

    def __init__(self) -> None:
        self.t_ns = 0


class FaultySolver:
    """``solver``, but for the spells in which it is in trouble."""

    def __init__(self, solver: Solver, faults: Sequence[SolverFaultInterval], now: SolverClock) -> None:
        self._solver = solver
        self._troubles = faults
        self._now = now

    def __getattr__(self, name: str) -> Any:
        return getattr(self._solver, name)

    def solve(self) -> SolverResult:
        """Its answer, or trouble."""
        answer = self._solver.solve()
        for fault, interval in self._troubles:
            if not interval.contains(self._now.t_ns):
                continue
            if fault is SolverFault.RAISES:
                raise InjectedSolverError("in trouble")
            status = SolveStatus.SOLVED if fault is SolverFault.LIES else SolveStatus.FAILED
            return SolverResult(np.full_like(answer.commands, math.nan), Solve(status=status, why=f"it {fault}"))
        return answer


class TimedNode:
    """A node that tells ``now`` the time of each of its steps."""

    def __init__(self, node: Node, now: SolverClock) -> None:
        self._node = node
        self._now = now

    @property
    def name(self) -> str:
        """As the node inside."""
        return self._node.name

    @property
    def schedule(self) -> Schedule:
        """As the node inside."""
        return self._node.schedule

    @property
    def reads(self) -> tuple[type[Message], ...]:
        """As the node inside."""
        return self._node.reads

    @property
    def writes(self) -> tuple[type[Message], ...]:
        """As the node inside."""
        return self._node.writes

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """The node's own steps, one at a time."""
        outputs: list[list[Message]] = []
        for one in due:
            self._now.t_ns = one[0]
            outputs += self._node.steps([one])
        return outputs


@contextmanager
def inject_solver_faults(faults: Sequence[SolverFaultInterval], now: SolverClock) -> Iterator[None]:
    """Controllers that are made here get solvers in trouble, the ones they make anew while they run too."""
    before: Any = controller.make  # type: ignore[attr-defined]  # its name for ``solvers.make``

    def make(*arguments: Any) -> Any:
        return FaultySolver(before(*arguments), faults, now)

    controller.make = make  # type: ignore[attr-defined, assignment]
    try:
        yield
    finally:
        controller.make = before  # type: ignore[attr-defined]
