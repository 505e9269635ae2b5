"""Convex quadratic programme (QP) and its solution, the common form of all solvers.

minimise 1/2 x' P x + q' x   subject to   l <= A x <= u
"""

from __future__ import annotations

from dataclasses import dataclass

from scipy.sparse import csc_array

from ltv_mpc.messages import Array, Solve


@dataclass(frozen=True, slots=True)
class QP:
    """Convex quadratic programme; equalities have l == u."""

    P: csc_array  # (n, n) symmetric positive semidefinite, both triangles
    q: Array  # (n,)
    A: csc_array  # (m, n)
    l: Array  # noqa: E741  (m,) the standard name
    u: Array  # (m,)


@dataclass(frozen=True, slots=True)
class Solution:
    """Solution of a QP, and the solver's report."""

    x: Array  # (n,) primal
    y: Array  # (m,) dual of l <= A x <= u: positive at u, negative at l
    solve: Solve
