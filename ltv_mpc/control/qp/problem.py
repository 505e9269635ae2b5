"""A convex quadratic programme and its solution, as every solver here takes and returns them.

minimise 1/2 x' P x + q' x   subject to   l <= A x <= u
"""

from __future__ import annotations

from dataclasses import dataclass

from scipy.sparse import csc_array

from ltv_mpc.messages import Array, Solve


@dataclass(frozen=True, slots=True)
class QP:
    """P (n, n) symmetric positive semidefinite, both triangles; A (m, n); equalities have l == u."""

    P: csc_array
    q: Array
    A: csc_array
    l: Array  # noqa: E741  (the standard name)
    u: Array


@dataclass(frozen=True, slots=True)
class Solution:
    """Primal x (n,), dual y (m,) of l <= A x <= u (positive at u, negative at l), and the solver's account."""

    x: Array
    y: Array
    solve: Solve
