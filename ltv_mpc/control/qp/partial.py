"""The partially condensed QP of the LTV-MPC: states kept at the ends of blocks of a few stages, commands at every knot.

Within a block from knot s to knot e the sparse QP's states (sparse.py) are eliminated as in condensed.py:

    x_k = T_k [x_s, z_s, .., z_k],   T_s = [I, 0],   T_(k+1) = A_k T_k + B0_k at z_k + B1_k at z_(k+1)
    cost of the knots between   1/2 sum over s < k < e of w_k |p(x_k)|^2 = 1/2 [..]' sum w_k T_p,k' T_p,k [..]
    x_e = T_e [x_s, z_s, .., z_e]

with its own cost at x_e. Two changes of the origin, which leave the optimum where it is, make the rest short:

- x is the deviation from the trajectory with what its gaps do (d_k of condensed.py), so the dynamics have no constant;
- to the cost is added mu_b' (T_b [..] - x_b), zero wherever the dynamics hold, with mu the costates along that
  trajectory. It takes the cost's slope in x away and leaves the condensed QP's f in z: the dynamics' duals are then
  near zero where the commands are near their optimum.

So zero is the first guess of x, z and the dynamics' duals alike. Unknowns: the x_b (8 each) divided by their scale,
then z = [dU_1 / F, .., dU_N / F]. Rows: dynamics of each block, bounds of z, slew rows of z as in condensed.py.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csc_array, diags_array

from ltv_mpc.compiled import kernel
from ltv_mpc.control.config import Weights
from ltv_mpc.control.constants import Objective, length, objective, pack_objective
from ltv_mpc.control.horizon import Linearisation
from ltv_mpc.control.limits import HorizonLimits
from ltv_mpc.control.qp import rows
from ltv_mpc.control.qp.condensed import commands, gradient, thrust_bounds, thrust_terms
from ltv_mpc.control.qp.problem import QP
from ltv_mpc.control.qp.rows import Row
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES

BLOCK = 7
"""Stages a block, about: the iterations get cheaper up to here, condensing and factorisation dearer beyond."""

Indices = npt.NDArray[np.int64]


class PartialForm:
    """The layout for given knots, and the numbers of the cycle built last."""

    def __init__(self, knots: Array, limits: HorizonLimits, weights: Weights, block: int = BLOCK) -> None:
        """``knots`` (N+1,) as in ``grid.py``, ``limits`` and ``weights`` stay the same; ``block``: stages in one."""
        N = self.stages = stages = len(knots) - 1
        blocks = max(1, round(stages / block))
        self.ends: Indices = np.round(np.linspace(0, stages, blocks + 1)).astype(np.int64)
        self.states = STATES * blocks  # unknowns x, and rows of the dynamics
        self.variables = self.states + 2 * N
        self.rows = self.states + 4 * N - 2
        self.numbers = pack_objective(knots, limits, weights)
        self.thrust_scale = limits.scale
        self._scale = np.concatenate([limits.state_scale, limits.scale])
        width = STATES + 2 * (int(np.diff(self.ends).max()) + 1)
        self.cost = np.zeros((blocks, width, width))  # of the knots inside a block: Q, its upper triangle
        self.end_cost = np.zeros((blocks, STATES, STATES))  # E
        self.motion = np.zeros((blocks, STATES, width))  # T_e
        self._T = np.zeros((2, STATES, width))
        self._make_patterns(blocks)
        self.P = np.zeros(self._P.nnz)  # the stored entries of its upper triangle
        self.q = np.zeros(self.variables)
        self._f = self.q[self.states :]
        self.lower = np.zeros(self.rows - self.states)  # of z and of the slew rows
        self.upper = np.zeros(self.rows - self.states)

    # --- where each number goes ---

    def _columns(self, b: int) -> Indices:
        """The unknowns that block b's local ones [x_s, z_s, .., z_e] are, -1 for those of knot 0, which are given."""
        s, e = self.ends[b], self.ends[b + 1]
        x = np.arange(STATES) + (b - 1) * STATES if b > 0 else np.full(STATES, -1)
        knots = np.arange(s, e + 1)
        z = np.where(knots > 0, self.states + 2 * (knots - 1), -1)[:, None] + np.where(knots > 0, [[0], [1]], 0).T
        return np.concatenate([x, z.ravel()])

    def _make_patterns(self, blocks: int) -> None:
        """P's upper triangle and A by columns; an entry's source is its place in the blocks' dense matrices."""
        cost = np.arange(self.cost.size).reshape(self.cost.shape)
        end = self.cost.size + np.arange(self.end_cost.size).reshape(self.end_cost.shape)
        motion = np.arange(self.motion.size).reshape(self.motion.shape)
        in_P: list[tuple[int, int, int]] = []
        in_A: list[tuple[int, int, int]] = []
        for b in range(blocks):
            columns = self._columns(b)
            inner = columns[: len(columns) - 2]  # the last command acts on the end alone
            in_P += [
                (int(inner[i]), int(inner[j]), int(cost[b, i, j]))
                for i in range(len(inner))
                for j in range(i, len(inner))
                if inner[i] >= 0
            ]
            own = b * STATES
            in_P += [(own + i, own + j, int(end[b, i, j])) for i in range(STATES) for j in range(i, STATES)]
            in_A += [
                (own + i, int(columns[j]), int(motion[b, i, j]))
                for i in range(STATES)
                for j in range(len(columns))
                if columns[j] >= 0
            ]
            in_A += [(own + i, own + i, -1) for i in range(STATES)]
        self._P, self._P_from, self._P_constant = self._pattern_of_P(in_P)
        self._A, self.A_from, self.A_row = self._pattern_of_A(in_A)

    def _pattern_of_P(self, entries: list[tuple[int, int, int]]) -> tuple[csc_array, Indices, Array]:
        """Up to two sources an entry (the cost inside a block and at its start), (nnz, 2), and the thrust terms."""
        N, n = self.stages, self.variables
        thrust = np.zeros((2 * N, 2 * N))
        thrust_terms(objective(self.numbers), thrust)
        sources: dict[tuple[int, int], list[int]] = {}
        for i, j, source in entries:
            sources.setdefault((i, j), []).append(source)
        for i, j in zip(*np.nonzero(np.triu(thrust)), strict=True):
            sources.setdefault((self.states + int(i), self.states + int(j)), [])
        rows, columns = np.array(list(sources)).T
        pattern = csc_array(coo_array((np.arange(1.0, len(rows) + 1.0), (rows, columns)), shape=(n, n)))
        order = pattern.data.astype(np.int64) - 1
        nothing = self.cost.size + self.end_cost.size  # one zero behind the blocks' numbers
        padded = [[*s, nothing, nothing][:2] for s in sources.values()]
        constant = np.zeros(len(rows))
        of_z = rows >= self.states
        constant[of_z] = thrust[rows[of_z] - self.states, columns[of_z] - self.states]
        return pattern, np.array(padded, dtype=np.int64)[order], constant[order]

    def _pattern_of_A(self, entries: list[tuple[int, int, int]]) -> tuple[csc_array, Indices, Indices]:
        """An entry's source, or -1 and -2 for -1.0 and 1.0; and its row."""
        N, first = self.stages, self.states
        entries = [*entries, *((first + i, first + i, -2) for i in range(2 * N))]
        slew = first + 2 * N
        entries += [(slew + i, first + i + 2, -2) for i in range(2 * N - 2)]
        entries += [(slew + i, first + i, -1) for i in range(2 * N - 2)]
        rows, columns, source = np.array(entries, dtype=np.int64).T
        shape = (self.rows, self.variables)
        pattern = csc_array(coo_array((np.arange(1.0, len(rows) + 1.0), (rows, columns)), shape=shape))
        order = pattern.data.astype(np.int64) - 1
        return pattern, source[order], rows[order]

    # --- the numbers of a cycle ---

    def build(self, lin: Linearisation, target: Array) -> bool:
        """The numbers of one cycle, and whether they are finite; ``target`` (N+1, 2) as in ``Solver``."""
        return _build(
            *lin[:-1],
            target,
            self.numbers,
            self._scale,
            self.ends,
            self._T,
            self.cost,
            self.end_cost,
            self.motion,
            self._P_from,
            self._P_constant,
            self.P,
            self._f,
            self.lower,
            self.upper,
        )

    def scaled_rows(self, row_scale: Array, A: Array) -> None:
        """A as it is stored, its rows multiplied by ``row_scale`` (m,), in place."""
        fill_A(self.motion, self.A_from, self.A_row, row_scale, A)

    @property
    def entries(self) -> int:
        """Stored entries of A."""
        return self._A.nnz

    def matrices(self, A: Array) -> tuple[csc_array, csc_array]:
        """P's upper triangle as it was built last, and A with these entries."""
        upper = csc_array((self.P.copy(), self._P.indices, self._P.indptr), shape=self._P.shape)
        return upper, csc_array((A.copy(), self._A.indices, self._A.indptr), shape=self._A.shape)

    def commands(self, lin: Linearisation, x: Array) -> tuple[Array, bool]:
        """Commands (N+1, 2) at the knots of a solution x (n,), and whether they are finite."""
        return commands(lin.U, x[self.states :], self.thrust_scale)

    @cached_property
    def row_names(self) -> tuple[Row, ...]:
        """What each row is."""
        stages, thrusts = range(1, self.stages + 1), self.thrust_scale
        return (
            *rows.dynamics(self.ends[1:].tolist(), self._scale),
            *rows.box(stages, thrusts),
            *rows.slew(stages[1:], thrusts),
        )

    def problem(self) -> QP:
        """The QP last built, its rows not scaled."""
        A = np.empty(self.entries)
        self.scaled_rows(np.ones(self.rows), A)
        upper, whole_A = self.matrices(A)
        whole = csc_array(upper + upper.T - diags_array(upper.diagonal()))
        dynamics = np.zeros(self.states)
        lower, upper_bound = (np.concatenate([dynamics, bound]) for bound in (self.lower, self.upper))
        return QP(whole, self.q.copy(), whole_A, lower, upper_bound)


@kernel
def _build(
    X: Array,
    U: Array,
    C: Array,
    Phi: Array,
    A: Array,
    B0: Array,
    B1: Array,
    target: Array,
    numbers: Array,
    scale: Array,
    ends: Indices,
    T: Array,
    cost: Array,
    end: Array,
    motion: Array,
    P_from: Indices,
    P_constant: Array,
    P: Array,
    f: Array,
    lower: Array,
    upper: Array,
) -> bool:
    """The blocks' matrices, P, f (2N,) and the bounds (4N-2,) in place; T (2, 8, width) is scratch."""
    o = objective(numbers)
    slope = gradient(X, U, C, Phi, A, B0, B1, target, o, f)
    thrust_bounds(U, o, lower, upper)
    last = ends.shape[0] - 2
    total = f.sum() + lower.sum() + upper.sum()
    for b in range(last + 1):
        _condense_block(A, B0, B1, ends[b], ends[b + 1], o, scale, T, cost[b], motion[b])
        weight = o.position * length(o, ends[b + 1])
        end[b] = 0.0
        for i in range(2):
            end[b, i, i] = (weight + (o.terminal_position if b == last else 0.0)) * scale[i] ** 2
        total += motion[b].sum() + cost[b].sum()
    for i in range(3):
        for j in range(3):
            both = slope[0, i] * slope[0, j] + slope[1, i] * slope[1, j]
            end[last, 2 + i, 2 + j] = o.terminal_velocity * both * scale[2 + i] * scale[2 + j]
    _fill_P(cost, end, P_from, P_constant, P)
    return bool(np.isfinite(total))


@kernel
def _condense_block(
    A: Array,
    B0: Array,
    B1: Array,
    s: int,
    e: int,
    o: Objective,
    scale: Array,
    T: Array,
    cost: Array,
    motion: Array,
) -> None:
    """Of the block from knot s to knot e: ``cost`` (upper triangle) and T_e divided by the states' scale, in place."""
    old = T[0]
    old[:] = 0.0
    cost[:] = 0.0
    for i in range(STATES):
        old[i, i] = scale[i]
    for k in range(s, e):
        new, old = T[(k - s + 1) % 2], T[(k - s) % 2]
        known = STATES + 2 * (k - s + 1)  # columns of x_s and of the commands up to knot k
        for i in range(6):
            out, a = new[i], A[k, i]
            r2, r3, r4, r5, r6, r7 = old[2], old[3], old[4], old[5], old[6], old[7]
            for j in range(known):
                out[j] = a[2] * r2[j] + a[3] * r3[j] + a[4] * r4[j] + a[5] * r5[j] + a[6] * r6[j] + a[7] * r7[j]
            if i < 2:
                carried = old[i]
                for j in range(known):
                    out[j] += carried[j]
        for i in range(6, STATES):
            for j in range(known):
                new[i, j] = A[k, i, i] * old[i, j]
        for i in range(STATES):
            for j in range(2):
                new[i, known - 2 + j] += B0[k, i, j] * scale[6 + j]
                new[i, known + j] = B1[k, i, j] * scale[6 + j]
        if k + 1 < e:
            north, east, weight = new[0], new[1], o.position * length(o, k + 1)
            for i in range(known + 2):
                wn, we, row = weight * north[i], weight * east[i], cost[i]
                for j in range(i, known + 2):
                    row[j] += wn * north[j] + we * east[j]
            for i in range(STATES):
                for j in range(2):
                    new[i, known + 2 + j] = 0.0
        else:
            for i in range(STATES):
                for j in range(known + 2):
                    motion[i, j] = new[i, j] / scale[i]


@kernel
def _fill_P(cost: Array, end: Array, source: Indices, constant: Array, P: Array) -> None:
    inside, ends = cost.ravel(), end.ravel()
    behind = inside.shape[0]
    for k in range(P.shape[0]):
        value = constant[k]
        for i in range(2):
            at = source[k, i]
            if at < behind:
                value += inside[at]
            elif at - behind < ends.shape[0]:
                value += ends[at - behind]
        P[k] = value


@kernel
def fill_A(motion: Array, source: Indices, row: Indices, scale: Array, A: Array) -> None:
    numbers = motion.ravel()
    for k in range(A.shape[0]):
        at = source[k]
        value = numbers[at] if at >= 0 else (1.0 if at == -2 else -1.0)
        A[k] = scale[row[k]] * value
