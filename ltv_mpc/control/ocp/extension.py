"""Cost terms and limits of a user, in Python: ``Controller(vehicle, reference, terms=[...])``.

A class derives from ``Term`` and returns residuals, or from ``Limit`` and returns values; nothing is compiled. Nominal
trajectory, line search, every solver and the check of the optimum take them like those of this project. The slopes are
found by central differences, unless the class gives its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.messages import Array

STATE_STEPS = np.array([1e-4, 1e-4, 1e-5, 1e-5, 1e-5, 1e-5, 1e-3, 1e-3, 1e-3, 1e-3])
"""Steps of the central differences, in the units of ``Motion.states``."""


class Motion(NamedTuple):
    """Motion along a horizon, at the knots 1 .. N.

    A state has north, east (m), surge, sway (m/s), heading (rad), yaw rate (rad/s), delivered and commanded thrusts of
    port and starboard (N).
    """

    states: Array  # (N, 10)
    lengths: Array  # (N,) of the stages that end there, in units of the first one
    target: Array  # (N, 2) north and east wanted (m)


class Term:
    """Cost term: half the sum of the squares of its residuals. A weight w goes in as its root."""

    def residuals(self, motion: Motion) -> Array:
        """Return the residuals (N, d) of a motion; those of a knot depend on that knot alone.

        Parameters
        ----------
        motion : at the knots 1 .. N.
        """
        raise NotImplementedError

    def slopes(self, motion: Motion) -> Array:
        """Return the derivatives (N, d, 10) of the residuals by the states.

        Parameters
        ----------
        motion : at the knots 1 .. N.
        """
        return _differences(self.residuals, motion)

    def cost(self, motion: Motion) -> float:
        """Return the cost of a motion.

        Parameters
        ----------
        motion : at the knots 1 .. N.
        """
        return 0.5 * float(np.sum(self.residuals(motion) ** 2))


class Limit:
    """Limit:  low <= values <= high,  soft with an exact penalty."""

    low: Sequence[float] = (-np.inf,)
    """(d,) lower bounds, in the unit of the values; -inf where there is none."""
    high: Sequence[float] = (np.inf,)
    """(d,) upper bounds."""
    unit: Sequence[float] = (1.0,)
    """(d,) value that counts as much as the vehicle's length."""
    penalty: float = 5000.0
    """Cost of an excess of one unit over the first stage; larger than the duals that occur."""

    def values(self, motion: Motion) -> Array:
        """Return the values (N, d) of a motion; those of a knot depend on that knot alone.

        Parameters
        ----------
        motion : at the knots 1 .. N.
        """
        raise NotImplementedError

    def slopes(self, motion: Motion) -> Array:
        """Return the derivatives (N, d, 10) of the values by the states.

        Parameters
        ----------
        motion : at the knots 1 .. N.
        """
        return _differences(self.values, motion)

    def cost(self, motion: Motion) -> float:
        """Return what the excesses of a motion cost.

        Parameters
        ----------
        motion : at the knots 1 .. N.
        """
        value = self.values(motion)
        excess = np.maximum(np.maximum(value - self.high, self.low - value), 0.0) / self.unit
        return self.penalty * float(motion.lengths @ excess.sum(axis=1))


class Extensions:
    """All terms and limits of a user, as the controller takes them."""

    def __init__(self, terms: Sequence[Term | Limit], lengths: Array, target: Array) -> None:
        """Take them.

        Parameters
        ----------
        terms : in any order.
        lengths : (N,) of the stages.
        target : (N+1, 3) as in ``ocp/terms.py``; each cycle overwrites it.
        """
        self._terms = [term for term in terms if isinstance(term, Term)]
        self._limits = [term for term in terms if isinstance(term, Limit)]
        self._lengths, self._target = lengths, target

    @property
    def rows(self) -> int:
        """Rows of limits at a knot."""
        return sum(len(limit.low) for limit in self._limits)

    def cost(self, X: Array, U: Array) -> float:
        """Return what a trajectory costs.

        Parameters
        ----------
        X : (N+1, 8) states at the knots.
        U : (N+1, 2) commands.
        """
        motion = self._motion(X, U)
        return sum(term.cost(motion) for term in self._terms) + sum(limit.cost(motion) for limit in self._limits)

    def add(self, p: Problem, first: int, X: Array, U: Array, scale: Array) -> None:
        """Add quadratic models and rows to a problem.

        Parameters
        ----------
        p : problem.
        first : number of the first row of these limits.
        X, U : the nominal trajectory, as in ``cost``.
        scale : (10,) what is 1 in the states of the problem.
        """
        motion = self._motion(X, U)
        n = len(scale)
        for term in self._terms:
            slopes = term.slopes(motion) * scale
            p.H[1:, :n, :n] += np.einsum("kdi,kdj->kij", slopes, slopes)
            p.h[1:, :n] += np.einsum("kdi,kd->ki", slopes, term.residuals(motion))
        for limit in self._limits:
            rows = slice(first, first + len(limit.low))
            value, unit = limit.values(motion), np.asarray(limit.unit)
            p.G[1:, rows, :n] = limit.slopes(motion) * scale / unit[:, None]
            p.low[1:, rows], p.high[1:, rows] = (limit.low - value) / unit, (limit.high - value) / unit
            p.penalty[1:, rows] = limit.penalty * self._lengths[:, None]
            first = rows.stop

    def _motion(self, X: Array, U: Array) -> Motion:
        return Motion(np.hstack([X[1:], U[1:]]), self._lengths, self._target[:-1, :2])


def _differences(function: object, motion: Motion) -> Array:
    """Return the derivatives (N, d, 10) of a function of a motion by its states, by central differences."""
    assert callable(function)
    columns = []
    for i, step in enumerate(STATE_STEPS):
        move = np.zeros(len(STATE_STEPS))
        move[i] = step
        above, below = (motion._replace(states=motion.states + sign * move) for sign in (1.0, -1.0))
        columns.append((function(above) - function(below)) / (2.0 * step))
    return np.stack(columns, axis=-1)
