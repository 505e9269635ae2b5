"""Sparse quadratic programme (QP) of a problem of stages, for general solvers.

    minimise 1/2 x' P x + q' x   subject to   l <= A x <= u

Columns: u_0, x_1, u_1, x_2, .. u_(N-1), x_N, which is z from its number n on, then an excess for each soft row. Rows:
the dynamics of each stage,

    F_k z_k - x_(k+1) = -f_k

then the limits, stage by stage. A hard row is one row of A. A soft one has up to three:

    G z - e <= high,    G z + e >= low,    e >= 0

The pattern holds what is not zero in the problem that it was made for. A problem that does not fit gets a pattern of
both, so it grows in the first cycles and then stays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csc_array

from ltv_mpc.control.config import Weights
from ltv_mpc.control.linearisation import linearise
from ltv_mpc.control.ocp.assembly import problem_along
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import STAGE_S, Constants
from ltv_mpc.control.scaling import default_weights
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Pair, Solve
from ltv_mpc.vehicle.parameters import Vehicle


@dataclass(frozen=True, slots=True)
class QP:
    """Convex quadratic programme; equalities have l == u."""

    P: csc_array  # (n, n) symmetric positive semidefinite, both triangles
    q: Array  # (n,)
    A: csc_array  # (m, n)
    l: Array  # noqa: E741  (m,)
    u: Array  # (m,)


@dataclass(frozen=True, slots=True)
class Solution:
    """Solution of a QP, and the solver's report."""

    x: Array  # (n,) primal
    y: Array  # (m,) dual of l <= A x <= u: positive at u, negative at l
    solve: Solve


@dataclass(frozen=True, slots=True)
class Residuals:
    """Residuals in the infinity norm; zero at the optimum."""

    stationarity: float  # P x + q + A' y
    primal: float  # violation of l <= A x <= u
    complementarity: float  # |y| times the distance from the bound that its sign names


def residuals(qp: QP, x: Array, y: Array) -> Residuals:
    """Return the residuals of a point.

    Parameters
    ----------
    qp : problem.
    x : (n,) primal point.
    y : (m,) dual, positive at u, negative at l.

    Returns
    -------
    Residuals of stationarity, feasibility and complementarity.
    """
    Ax = qp.A @ x
    stationarity = np.abs(qp.P @ x + qp.q + qp.A.T @ y).max()
    primal = max(np.maximum(qp.l - Ax, 0.0).max(), np.maximum(Ax - qp.u, 0.0).max())
    on = y != 0.0
    off = (np.where(y > 0.0, qp.u, qp.l) - Ax)[on]
    return Residuals(float(stationarity), float(primal), float(np.abs(y[on] * off).max(initial=0.0)))


Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

Entries: TypeAlias = tuple[Indices, Indices, Indices]
"""Row and column of some entries, and where their numbers come from."""

DYNAMICS, HARD, UPPER, LOWER, EXCESS = range(5)
"""Kinds of rows."""

NO_PENALTY = 1e6
"""Cost of the excess of a row that has no bound in this problem."""


class Numbers(NamedTuple):
    """Numbers of one QP."""

    P: Array  # stored entries of the upper triangle of P, by column
    q: Array  # (n,)
    A: Array  # stored entries of A, by column
    l: Array  # noqa: E741  (m,)
    u: Array  # (m,)


class Masks(NamedTuple):
    """Entries of a layout that may differ from zero, and bounds that may be finite."""

    H: Mask
    F: Mask
    G: Mask
    low: Mask
    high: Mask
    soft: Mask


class Places(NamedTuple):
    """Places of a problem's numbers in the QP: among stored entries, with indices in flat arrays."""

    excess: Indices  # (N+1, M) column of each row's excess; -1: none
    kind: Indices  # (rows,) kind of each row of A
    source: Indices  # (rows,) index of its dynamics in f, or of its limit in low
    H: Indices  # (2, .) places in P, and indices in H
    F: Indices  # (2, .) places in A, and indices in F
    G: Indices  # (2, .) places in A, and indices in G
    row: Indices  # (stored entries of A,) row of each


class SparseLayout:
    """Layout of the QP of problems of one size."""

    def __init__(self, p: Problem, before: SparseLayout | None = None) -> None:
        """Lay out the QP of a problem, and of those of an earlier layout.

        Parameters
        ----------
        p : problem.
        before : layout of problems of the same size.
        """
        masks = [part != 0.0 for part in (p.H, p.F, p.G)]
        masks += [np.isfinite(part) for part in (p.low, p.high, p.penalty)]
        if before is not None:
            masks = [here | there for here, there in zip(masks, before.masks, strict=True)]
        self.masks: Masks = Masks(*masks)
        N, n, m, _ = p.sizes
        z = n + m
        column = np.arange((N + 1) * z).reshape(N + 1, z) - n
        self.column: Indices = np.where(column < N * z, column, -1)
        """(N+1, n+m) column of each number of z; negative: none."""
        has_bound = self.masks.low | self.masks.high
        soft = self.masks.soft & has_bound
        excess = np.where(soft, N * z + np.cumsum(soft).reshape(soft.shape) - 1, -1)
        rows = [(DYNAMICS, i) for i in range(N * n)]
        for i in np.flatnonzero(has_bound).tolist():
            sides = ((UPPER, self.masks.high), (LOWER, self.masks.low), (EXCESS, soft))
            rows += [(side, i) for side, mask in sides if mask.flat[i]] if soft.flat[i] else [(HARD, i)]
        kind, source = np.array(rows, dtype=np.int64).reshape(-1, 2).T
        self.of_limit = np.flatnonzero((kind != DYNAMICS) & (kind != EXCESS))
        """Rows of limits."""
        self.soft_rows = int(soft.sum())
        """Number of soft rows of limits."""
        self.variables = N * z + self.soft_rows
        """Number of columns n."""
        self.rows = len(kind)
        """Number of rows m."""
        self.P, H = _placed(*_hessian_entries(self.masks.H, self.column), (self.variables, self.variables))
        entries = _row_entries(self.masks, self.column, excess, kind, source, self.of_limit)
        row, col, index = (np.concatenate(part) for part in zip(*entries, strict=True))
        self.A, at = _placed(row, col, index, (self.rows, self.variables))
        """Pattern of A; its numbers are those that never change."""
        F, G, constant = np.split(at, np.cumsum([len(part[0]) for part in entries])[:2], axis=1)
        self.A.data[:] = 0.0
        self.A.data[constant[0]] = constant[1]
        self.places = Places(excess, kind, source, H, F, G, self.A.indices.astype(np.int64))

    def allocate(self) -> Numbers:
        """Return arrays for the numbers of a QP, with those entries of A that never change."""
        return Numbers(
            np.zeros(self.P.nnz), np.zeros(self.variables), self.A.data.copy(), np.zeros(self.rows), np.zeros(self.rows)
        )

    def qp(self, p: Problem) -> QP:
        """Return the QP of a problem, with both triangles of P.

        Parameters
        ----------
        p : fits the layout.
        """
        numbers = self.allocate()
        fill(p, self.places, numbers)
        upper = csc_array((numbers.P, self.P.indices, self.P.indptr), shape=self.P.shape)
        both = csc_array(upper + upper.T - csc_array(np.diag(upper.diagonal())))
        A = csc_array((numbers.A, self.A.indices, self.A.indptr), shape=self.A.shape)
        return QP(both, numbers.q, A, numbers.l, numbers.u)


def sparse_qp(p: Problem) -> QP:
    """Return the sparse QP of a problem.

    Parameters
    ----------
    p : problem.
    """
    return SparseLayout(p).qp(p)


def build_qp(
    vehicle: Vehicle,
    X: Array,
    U: Array,
    current: Array,
    reference: Array,
    weights: Weights | None = None,
    *,
    end_velocity_mps: Pair = (0.0, 0.0),
) -> QP:
    """Build the QP of one cycle, linearised along a trajectory with knots 0.3 s apart.

    Parameters
    ----------
    vehicle : gives the motion, the limits of the thrusters and the scales.
    X : (N+1, 8) states n, e (m), u, v (m/s), psi (rad), r (rad/s), delivered port and starboard thrust (N).
    U : (N+1, 2) commands of port and starboard (N).
    current : (N+1, 2) north and east (m/s).
    reference : (N, 2) north and east (m) wanted at the knots 1 .. N.
    weights : default: those that follow from the vehicle.
    end_velocity_mps : velocity over ground wanted at the last knot, north and east.

    Returns
    -------
    The QP in scaled deviations from X and U; the head of ``ltv_mpc/control/solvers/sparse.py`` lists its rows and
    columns, that of ``ltv_mpc/control/ocp/assembly.py`` the numbers of a stage.
    """
    lin = linearise(X, U, current, STAGE_S, vehicle.coefficients())
    constants = Constants.of(vehicle, weights or default_weights(vehicle), np.arange(float(len(U))))
    return sparse_qp(problem_along(lin, np.vstack([reference, end_velocity_mps]), constants))


def solution_of(p: Problem, x: Array) -> Array:
    """Return states and inputs (N+1, n+m) of a solution x of ``sparse_qp``.

    Parameters
    ----------
    p : problem.
    x : primal solution.
    """
    N, n, m, _ = p.sizes
    z, columns = np.zeros((N + 1, n + m)), N * (n + m)
    z.flat[n : n + columns] = x[:columns]
    return z


def _hessian_entries(mask: Mask, column: Indices) -> Entries:
    """Return the entries of the upper triangle of P, with their indices in H."""
    k, i, j = np.nonzero(mask)
    row, col = column[k, i], column[k, j]
    stored = (row >= 0) & (col >= 0) & (row <= col)
    return row[stored], col[stored], np.flatnonzero(mask)[stored]


def _row_entries(
    masks: Masks, column: Indices, excess: Indices, kind: Indices, source: Indices, of_limit: Indices
) -> tuple[Entries, Entries, Entries]:
    """Return the entries of A: of F and of G, with their indices there, and the constant ones, with their values."""
    F, G = masks.F, masks.G
    N, n, _ = F.shape
    k, i, j = np.nonzero(F)
    stored = column[k, j] >= 0
    of_F = k[stored] * n + i[stored], column[k, j][stored], np.flatnonzero(F)[stored]
    k, i = np.divmod(source[of_limit], max(G.shape[1], 1))
    entry, j = np.nonzero(G[k, i] & (column[k] >= 0))
    of_G = of_limit[entry], column[k[entry], j], source[of_limit[entry]] * G.shape[2] + j
    soft = np.flatnonzero((kind != DYNAMICS) & (kind != HARD))
    constant = (
        np.concatenate([np.arange(N * n), soft]),
        np.concatenate([column[1:, :n].ravel(), excess.flat[source[soft]]]),
        np.concatenate([np.full(N * n, -1), np.where(kind[soft] == UPPER, -1, 1)]),
    )
    return of_F, of_G, constant


def _placed(row: Indices, column: Indices, index: Indices, shape: tuple[int, int]) -> tuple[csc_array, Indices]:
    """Return the pattern with these entries, and their places in it above the given indices."""
    number = np.arange(1.0, len(row) + 1.0)
    pattern = csc_array(coo_array((number, (row.astype(np.int32), column.astype(np.int32))), shape=shape))
    return pattern, np.stack([np.argsort(pattern.data), index])


@jit
def fits(p: Problem, masks: Masks) -> bool:
    """Return True if a problem has no entry and no bound that a layout does not have.

    Parameters
    ----------
    p : problem.
    masks : entries and bounds of the layout.
    """
    missing = 0
    for part, mask in ((p.H, masks.H), (p.F, masks.F), (p.G, masks.G)):
        for i in range(part.size):
            missing += bool(part.flat[i] != 0.0) and not mask.flat[i]
    for part, mask in ((p.low, masks.low), (p.high, masks.high), (p.penalty, masks.soft)):
        for i in range(part.size):
            missing += bool(abs(part.flat[i]) < np.inf) and not mask.flat[i]
    return missing == 0


@jit
def fill(p: Problem, at: Places, to: Numbers) -> None:
    """Compute the numbers of the QP of a problem that fits its layout.

    Parameters
    ----------
    p : problem.
    at : places of its numbers.
    to : is overwritten.
    """
    for i in range(at.H.shape[1]):
        to.P[at.H[0, i]] = p.H.flat[at.H[1, i]]
    for i in range(at.F.shape[1]):
        to.A[at.F[0, i]] = p.F.flat[at.F[1, i]]
    for i in range(at.G.shape[1]):
        to.A[at.G[0, i]] = p.G.flat[at.G[1, i]]
    for i in range(len(p.f) * p.h.shape[1]):
        to.q[i] = p.h.flat[p.f.shape[1] + i]
    for row in range(len(at.kind)):
        kind, i = at.kind[row], at.source[row]
        if kind == DYNAMICS:
            to.l[row] = to.u[row] = -p.f.flat[i]
        elif kind == EXCESS:
            to.l[row], to.u[row] = 0.0, np.inf
            to.q[at.excess.flat[i]] = NO_PENALTY if p.penalty.flat[i] > NO_PENALTY else p.penalty.flat[i]
        else:
            to.l[row] = p.low.flat[i] if kind != UPPER else -np.inf
            to.u[row] = p.high.flat[i] if kind != LOWER else np.inf
