"""Sparse quadratic programme (QP) of a problem of stages, for general solvers.

    minimise 1/2 x' P x + q' x   subject to   l <= A x <= u

Columns: u_0, x_1, u_1, x_2, .. u_(N-1), x_N, then an excess for each soft row. Rows: the dynamics of each stage,

    F_k z_k - x_(k+1) = -f_k

then the limits, stage by stage. A hard row is one row of A. A soft one has up to three:

    G z - e <= high,    G z + e >= low,    e >= 0

The pattern holds what is not zero in the problem that it was made for. A problem that does not fit gets a pattern of
both, so it grows in the first cycles and then stays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csc_array

from ltv_mpc.control.config import Weights
from ltv_mpc.control.linearisation import linearise
from ltv_mpc.control.ocp.assembly import problem_along
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import STAGE_S, Constants
from ltv_mpc.control.qp import QP
from ltv_mpc.control.scaling import default_weights
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Pair
from ltv_mpc.vehicle.parameters import Vehicle

Indices = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

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

    column: Indices  # (N+1, n+m) column of each number of z; -1: none
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
        column = np.full((N + 1, z), -1, dtype=np.int64)
        stages = np.arange(N * z).reshape(N, z)
        column[:-1, n:], column[1:, :n] = stages[:, :m], stages[:, m:]
        has_bound = self.masks.low | self.masks.high
        soft = self.masks.soft & has_bound
        excess = np.where(soft, N * z + np.cumsum(soft).reshape(soft.shape) - 1, -1)
        rows = [(DYNAMICS, i) for i in range(N * n)]
        for i in np.flatnonzero(has_bound).tolist():
            sides = ((UPPER, self.masks.high), (LOWER, self.masks.low), (EXCESS, soft))
            rows += [(side, i) for side, mask in sides if mask.flat[i]] if soft.flat[i] else [(HARD, i)]
        kind, source = np.array(rows, dtype=np.int64).reshape(-1, 2).T
        self.limit: Indices = np.where((kind == DYNAMICS) | (kind == EXCESS), -1, source)
        """Index of each row's limit in low; -1 for a row that is none."""
        self.soft_rows = int(soft.sum())
        """Number of soft rows of limits."""
        self.variables = N * z + self.soft_rows
        """Number of columns n."""
        self.rows = len(kind)
        """Number of rows m."""
        self.P, H = _placed(*_hessian_entries(self.masks.H, column), (self.variables, self.variables))
        row, col, index, first_G, first_constant, values = _row_entries(self.masks, column, excess, kind, source)
        self.A, at = _placed(row, col, index, (self.rows, self.variables))
        """Pattern of A; its numbers are those that never change."""
        self.A.data[:] = 0.0
        self.A.data[at[0, first_constant:]] = values
        F, G = at[:, :first_G], at[:, first_G:first_constant]
        self.places = Places(column, excess, kind, source, H, F, G, self.A.indices.astype(np.int64))

    def allocate(self) -> Numbers:
        """Return arrays for the numbers of a QP, with those entries of A that never change."""
        return Numbers(
            np.zeros(self.P.nnz), np.zeros(self.variables), self.A.data.copy(), np.zeros(self.rows), np.zeros(self.rows)
        )

    def filled(self, p: Problem) -> Numbers:
        """Return the numbers of the QP of a problem.

        Parameters
        ----------
        p : fits the layout.
        """
        numbers = self.allocate()
        fill(p, self.places, numbers)
        return numbers

    def assemble(self, numbers: Numbers) -> QP:
        """Return the QP that has these numbers, with both triangles of P.

        Parameters
        ----------
        numbers : of this layout.
        """
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
    layout = SparseLayout(p)
    return layout.assemble(layout.filled(p))


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
    z, stages = np.zeros((N + 1, n + m)), x[: N * (n + m)].reshape(N, n + m)
    z[:-1, n:], z[1:, :n] = stages[:, :m], stages[:, m:]
    return z


def _hessian_entries(mask: Mask, column: Indices) -> tuple[Indices, Indices, Indices]:
    """Return row, column and index in H of the entries of the upper triangle of P."""
    k, i, j = np.nonzero(mask)
    row, col = column[k, i], column[k, j]
    stored = (row >= 0) & (col >= 0) & (row <= col)
    return row[stored], col[stored], np.flatnonzero(mask)[stored]


def _row_entries(
    masks: Masks, column: Indices, excess: Indices, kind: Indices, source: Indices
) -> tuple[Indices, Indices, Indices, int, int, Array]:
    """Return row, column and index of the entries of A: those of F, of G, the constant ones; and their values."""
    F, G = masks.F, masks.G
    N, n, _ = F.shape
    k, i, j = np.nonzero(F)
    stored = column[k, j] >= 0
    parts = [(k[stored] * n + i[stored], column[k, j][stored], np.flatnonzero(F)[stored])]
    of_limit = np.flatnonzero((kind != DYNAMICS) & (kind != EXCESS))
    k, i = np.divmod(source[of_limit], max(G.shape[1], 1))
    entry, j = np.nonzero(G[k, i] & (column[k] >= 0))
    parts.append((of_limit[entry], column[k[entry], j], source[of_limit[entry]] * G.shape[2] + j))
    of_excess = np.flatnonzero((kind != DYNAMICS) & (kind != HARD))
    parts.append((np.arange(N * n), column[1:, :n].ravel(), np.zeros(N * n, dtype=np.int64)))
    parts.append((of_excess, excess.flat[source[of_excess]], np.zeros(len(of_excess), dtype=np.int64)))
    row, col, index = (np.concatenate(of) for of in zip(*parts, strict=True))
    first_G, first_constant = len(parts[0][0]), len(parts[0][0]) + len(parts[1][0])
    values = np.concatenate([-np.ones(N * n), np.where(kind[of_excess] == UPPER, -1.0, 1.0)])
    return row, col, index, first_G, first_constant, values


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
    for k in range(at.column.shape[0]):
        for j in range(at.column.shape[1]):
            if at.column[k, j] >= 0:
                to.q[at.column[k, j]] = p.h[k, j]
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
