"""Solver interface: from the problem of one cycle to its states and inputs."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.messages import Array, Solve


class Result(NamedTuple):
    """Solution of a problem, and the solver's report."""

    z: Array  # (N+1, n+m) states and inputs; zeros if there is no solution
    solve: Solve


class Solver(Protocol):
    """Solver of a problem of stages (ocp/problem.py), which keeps workspace and warm start from cycle to cycle.

    A solver of the table ``SOLVERS`` has the constructor ``Solver(config)``, with resolved settings. A cycle calls
    ``shift_warm_start`` or ``reset_warm_start``, then ``build``, ``update`` and ``solve``. A problem that cannot be
    solved is reported by the status of the result, not by an exception. The controller still treats an exception as a
    failed solve, because solvers of other authors may raise. docs/add-solver.md shows how to add one.

    If another QP of the same cycle follows, the cycle calls ``draft()`` after ``build``, if the solver has it. It
    returns an exact result without the solver's last check, which replaces ``update`` and ``solve``, or None.
    """

    def shift_warm_start(self, stages: float) -> None:
        """Prepare the warm start for knots that lie later along the same plan.

        Parameters
        ----------
        stages : by how many first stages the next problem's knots lie later than the last one's.
        """
        ...

    def reset_warm_start(self) -> None:
        """Discard the warm start: the next problem is unrelated to the last one."""
        ...

    def build(self, problem: Problem) -> None:
        """Take the problem.

        Parameters
        ----------
        problem : of any size; the next cycle overwrites it. The first one of a size is never solved: it has a number in
            every place where a later one can have one, so that a sparse solver knows its pattern.
        """
        ...

    def update(self) -> None:
        """Pass the numbers to the solver's workspace."""
        ...

    def solve(self) -> Result:
        """Solve the problem that was built last.

        Returns
        -------
        Solution and report. Numbers that are not finite are never returned: zeros replace them.
        """
        ...
