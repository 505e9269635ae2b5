"""Solver interface: from the linearisation of one cycle to commands."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.messages import Array, Solve


class SolverResult(NamedTuple):
    """Commands of a solve, and the solver's report."""

    commands: Array  # (N+1, 2) port and starboard thrust at the knots (N); the first is the command in force
    solve: Solve


class Solver(Protocol):
    """Solver of the controller's QP (qp/sparse.py), which keeps its workspace and warm start from cycle to cycle.

    A solver of the table ``SOLVERS`` has the constructor ``Solver(config, limits)``, with resolved settings and limits.
    A cycle calls ``shift_warm_start`` or ``reset_warm_start``, then ``build``, ``update`` and ``solve``. A problem that
    cannot be solved is reported by the status of the result, not by an exception. The controller still treats an
    exception as a failed solve, because solvers of other authors may raise. docs/add-solver.md shows how to add one.
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

    def build(self, lin: Linearisation, target: Array) -> None:
        """Compute the problem's numbers.

        Parameters
        ----------
        lin : the motion along the nominal trajectory.
        target : (N+1, 3) north and east: the positions (m) wanted at the knots 1 .. N, then the velocity over ground
            (m/s) wanted at the last one. Third column: the heading (rad) wanted at the knots 1 .. N. It is read only if
            the weights have a heading, and may be left out otherwise.
        """
        ...

    def update(self) -> None:
        """Pass the numbers to the solver's workspace."""
        ...

    def solve(self) -> SolverResult:
        """Solve the problem that was built last.

        Returns
        -------
        Commands and report. Commands that are not finite are never returned: the nominal commands replace them.
        """
        ...
