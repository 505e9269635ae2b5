"""Cycle: what the trajectories and problems of one cycle are made from, and the problems themselves.

The arrays stay the same from cycle to cycle, and each cycle overwrites them. There are two problems: with the rows of
fence and corridor and without, because a problem without them is solved faster.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ltv_mpc.control.fence_clearance import Scene
from ltv_mpc.control.linearisation import Linearisation, linearise_along
from ltv_mpc.control.ocp import assembly, fence, limits
from ltv_mpc.control.ocp.extension import Extensions, Limit, Term
from ltv_mpc.control.ocp.problem import Problem, least_surplus
from ltv_mpc.control.problem_data import CHANGES, COMMANDS, STAGE_S, Constants
from ltv_mpc.messages import Array


class Score(NamedTuple):
    """Costs of a trajectory, and how it ends."""

    cost: float  # without fence and corridor
    fence: float  # cost of too small clearances
    stuck: bool  # as in ``TerminalCheck``
    tail: float  # cost beyond the horizon


UNKNOWN = Score(math.inf, math.inf, False, 0.0)
"""Score of no trajectory."""


class Cycle:
    """Constants, target, zones and linearisation of a cycle, and its problems."""

    def __init__(self, constants: Constants, scene: Scene, terms: Sequence[Term | Limit] = ()) -> None:
        """Allocate the arrays.

        Parameters
        ----------
        constants : of the controller; a cycle may begin with others.
        scene : zones and obstacles.
        terms : of a user, beside those of ``ocp/``.
        """
        stages = len(constants.t) - 1
        self.constants, self.scene = constants, scene
        self.target = np.zeros((stages + 1, 3))
        """Target at the knots (``ocp/terms.py``)."""
        self.lin = Linearisation.empty(stages)
        """The motion along the nominal trajectory."""
        self.start = np.zeros(CHANGES)
        """State at the first knot, and commands there."""
        self.score = UNKNOWN
        """Score of the nominal trajectory."""
        self.further = Extensions(terms, np.diff(constants.t), self.target) if terms else None
        """Terms and limits of a user."""
        self.plain = assembly.empty(stages, 0 if self.further is None else self.further.rows)
        """Problem without the rows of the fence."""
        self.fenced: Problem | None = None
        """Problem with these rows; None if there is no fence."""

    def linearise(self, lin: Linearisation) -> None:
        """Linearise along a trajectory.

        Parameters
        ----------
        lin : has the trajectory, and is overwritten.
        """
        linearise_along(lin, self.constants.t, STAGE_S, self.constants.p)

    def set_fence_rows(self, rows: int) -> bool:
        """Set how many rows of a knot are those of fence and corridor, and return True if the number has changed.

        Parameters
        ----------
        rows : 0 without a fence.
        """
        if rows == self.fence_rows:
            return False
        further = self.plain.low.shape[1] - limits.ROWS
        self.fenced = assembly.empty(len(self.target) - 1, further + rows) if rows else None
        return True

    @property
    def fence_rows(self) -> int:
        """Rows of fence and corridor at a knot."""
        return 0 if self.fenced is None else self.fenced.low.shape[1] - self.plain.low.shape[1]

    def fill(self, problem: Problem) -> Problem:
        """Fill in one of both problems along the nominal trajectory, and return it.

        Parameters
        ----------
        problem : is overwritten.
        """
        self._fill(problem, self.lin, self.target)
        if problem is self.fenced:
            fence.fill(self.constants, self.lin.X, self.scene, self.fence_rows, problem)
        return problem

    def _fill(self, problem: Problem, lin: Linearisation, target: Array) -> None:
        """Fill in all but the rows of the fence."""
        o = self.constants
        assembly.fill(o, lin, target, problem)
        if self.further is not None:
            scale = np.concatenate([o.state_scale, o.thrust_scale, o.thrust_scale])
            self.further.add(problem, limits.ROWS, lin.X, lin.U, scale)

    def surplus(self, z: Array) -> float:
        """Return by how much a solution keeps the rows of the fence; negative: not all of them.

        Parameters
        ----------
        z : (N+1, 12) solution of either problem; the other one is filled in.
        """
        return np.inf if self.fenced is None else least_surplus(self.fenced, z, self.plain.low.shape[1])

    def commands(self, z: Array) -> Array:
        """Return the commands (N+1, 2) of a solution (N).

        Parameters
        ----------
        z : (N+1, 12) solution; the first row is the command in force.
        """
        commands = z[:, COMMANDS:CHANGES] * self.constants.thrust_scale
        commands += self.lin.U
        return commands

    @property
    def position_scale_m(self) -> float:
        """Scale S of a position."""
        return float(self.constants.state_scale[0])

    def full_problem(self, problem: Problem, lin: Linearisation) -> Problem:
        """Return a problem of a size in which every number that can differ from zero does: it gives the pattern.

        Otherwise the pattern, and with it the rounding, would depend on what was solved before.

        Parameters
        ----------
        problem : of that size.
        lin : along any motion of the vehicle.
        """
        N, n, m, M = problem.sizes
        full, first = Problem.empty(N, n, m, M), self.plain.sizes[3]
        self._fill(full, lin, np.ones_like(self.target))
        full.G[1:, first:, :2], full.low[1:, first:], full.penalty[1:, first:] = 1.0, -1.0, 1.0
        return full
