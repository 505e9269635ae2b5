"""What a solver is to the controller: from a linearised cycle to commands."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.messages import Array, Solve


class SolverResult(NamedTuple):
    """Commands (N+1, 2) at the knots, the first of them the one in force there, and the solver's account."""

    commands: Array
    solve: Solve


class Solver(Protocol):
    """Keeps its workspace and its warm start from cycle to cycle; never raises for a problem it cannot solve."""

    def shift_warm_start(self, stages: float) -> None:
        """The next problem's knots begin so many first stages after the last one's, along the same plan."""
        ...

    def reset_warm_start(self) -> None:
        """The next problem has nothing to do with the last one."""
        ...

    def build(self, lin: Linearisation, target: Array) -> None:
        """The problem's numbers.

        ``target`` (N+1, 2), north and east: the positions (m) wanted at the knots 1 .. N, then the velocity over
        ground (m/s) wanted at the last one.
        """
        ...

    def update(self) -> None:
        """The numbers into the solver."""
        ...

    def solve(self) -> SolverResult:
        """Solve what was built; commands that are not finite are never handed out."""
        ...
