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
    """Solver of problems of stages (ocp/problem.py) of one size, which keeps its workspace from solve to solve.

    A solver of the table ``SOLVERS`` has the constructor ``Solver(config)``, with resolved settings. A problem that
    cannot be solved is reported by the status of the result, not by an exception. The controller still treats an
    exception as a failed solve, because solvers of other authors may raise. docs/add-solver.md shows how to add one.
    """

    def set_up(self, problem: Problem) -> None:
        """Prepare the solver, once and before the first solve.

        Parameters
        ----------
        problem : has a number in every place where a later one can have one, so that a sparse solver knows its pattern;
            it is not to be solved.
        """
        ...

    def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:
        """Solve a problem.

        Parameters
        ----------
        problem : the next cycle overwrites it.
        shift : by how many first stages its knots lie later, along the same plan, than those of the last one; NaN if
            the last one is not related to it: begin without a warm start.
        last : False if another QP of the cycle follows, whose nominal trajectory comes from this solution.

        Returns
        -------
        Solution and report. Numbers that are not finite are never returned: zeros replace them.
        """
        ...
