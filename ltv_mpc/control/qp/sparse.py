"""Sparse quadratic programme (QP) of one LTV-MPC cycle, in deviations from the nominal trajectory.

    minimise   1/2 sum over k = 1..N of  [ g_k (w |p_k - ref_k|^2 + r |U_k / F|^2) + s / g_k |(U_k - U_(k-1)) / F|^2
                                           + g_k w_psi (psi_k - psiref_k)^2 ]
               + 1/2 w_N |p_N - ref_N|^2 + 1/2 m |p'_N - ref'_N|^2
    subject to dX_(k+1) = A_k dX_k + B0_k dU_k + B1_k dU_(k+1) + Phi_k - Xbar_(k+1),   dX_0 = 0, dU_0 = 0
               p'_N = V dX_N + p'bar_N
               |U_(k+1) - U_k| <= slew h_(k+1),   min <= Ubar_k + dU_k <= max

and for each state x that has a limit (horizon_limits.py), with the additional cost  c g_k e_k / S  of its excess e_k
and c = ``excess_penalty``,

               xbar_k + dx_k - e_k <= high_state,   xbar_k + dx_k + e_k >= low_state,   e_k >= 0

and for each half-plane of the fence (fence_rows.py), with its normal a, its least deviation b and the cost c f_k of its
excess f_k,

               a' dp_k + f_k >= b,   f_k >= 0

g_k = h_k / 0.3 s is the length of the stage that ends at knot k (shooting_grid.py), p = [n, e], p' the velocity over
ground, F the thrusters' largest thrust, dX = X - Xbar. The cost of the terminal velocity separates a vehicle that stops
on its point from one that passes or orbits it: within a short horizon both are equally near. The sparsity pattern is
fixed by N and by the number of half-planes: only numbers change from cycle to cycle.

Variables are scaled to be of order one; the rows of the dynamics are divided by the same scales. S comes from the
vehicle (scaling.py), its last two components are F. A solver may scale the rows further (solvers/osqp.py).

Columns of A, for stages k = 0 .. N-1:

    dX_(k+1) / S, dU_(k+1) / F       10 k + 0 .. 9      ``STAGE_VARIABLES`` a stage
    p'_N - ref'_N                    10 N + 0 .. 1
    excess of a limited state        10 N + 2 + ...     one a stage and limited state
    excess of a half-plane           behind these       one a stage and half-plane

Rows of A, with E = 8 N + 2 (``SparseQp.equalities``) and thruster i = 0 (port), 1 (starboard):

    dynamics                         8 k + 0 .. 7       l = u
    terminal velocity                8 N + 0 .. 1       l = u
    slew of thruster i               E + 2 k + i        change from knot k to knot k + 1
    box of thruster i                E + 2 (N + k) + i
    limit of a state                 E + 4 N + ...      upper, lower, excess: 3 a stage and limited state
    half-plane                       behind these       bound, excess: 2 a stage and half-plane

``_constant_entries`` and ``_jacobian_entries`` place the entries of A, ``fill`` computes a cycle's numbers. A solver
minimises  1/2 x'Px + q'x  (problem.py): the constant part of the cost is left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csc_array

from ltv_mpc.control.config import STAGE_NS, Weights
from ltv_mpc.control.horizon_limits import LIMITED_STATES, NO_BOUND, HorizonLimits, command_bounds
from ltv_mpc.control.linearisation import (
    Linearisation,
    linearise,
    storage_size,
    unpack_linearisation,
    velocity_over_ground,
)
from ltv_mpc.control.problem_data import (
    Objective,
    excess_penalty,
    heading_slope,
    is_limited,
    pack_objective,
    stage_length,
    state_scale,
    unpack_objective,
)
from ltv_mpc.control.qp import rows
from ltv_mpc.control.qp.problem import QP
from ltv_mpc.control.qp.rows import ConstraintRow
from ltv_mpc.control.scaling import default_weights
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Pair
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Vehicle

Indices = npt.NDArray[np.int64]

STAGE_VARIABLES = STATES + 2
"""Variables a stage: the state at its end and both commands there."""

STATE_PATTERN = np.ones((STATES, STATES), dtype=bool)
"""Entries of A_k that can differ from zero: a position depends on itself and on the rest, a thrust on itself alone."""
STATE_PATTERN[:, :2] = False
STATE_PATTERN[6:, :] = False
np.fill_diagonal(STATE_PATTERN, True)

THRUST_PATTERN = np.ones((STATES, 2), dtype=bool)
"""Entries of B0_k and B1_k that can differ from zero."""
THRUST_PATTERN[6, 1] = THRUST_PATTERN[7, 0] = False


class QpNumbers(NamedTuple):
    """Numbers of one QP that change every cycle; P does not."""

    A: Array  # (nnz,) stored entries of A, by column
    q: Array  # (n,)
    l: Array  # noqa: E741  (m,)
    u: Array  # (m,)


class EntryMap(NamedTuple):
    """Places of a cycle's numbers among the stored entries of A: A[place] = lin.flat[source] * factor."""

    place: Indices  # (number of Jacobian entries,)
    source: Indices  # of the same length, as the next one
    factor: Array  # scale of the column over that of the row
    velocity: Indices  # (6,) places of V, the derivative of the terminal velocity, by row
    normal: Indices  # (2 N M,) places of the half-planes' normals
    row: Indices  # (nnz,) row of each stored entry


class SparseQp:
    """Sparse QP layout for given knots, limits and weights: columns and rows as at the head of this file.

    The layout follows the number of half-planes of the linearisation that it is given (``match``).
    """

    def __init__(self, knots: Array, limits: HorizonLimits, weights: Weights) -> None:
        """Lay out the QP without half-planes and compute P, which changes only with their number.

        Parameters
        ----------
        knots : (N+1,) times of the knots in first stages (shooting_grid.py).
        limits : limits of thrusters and motion.
        weights : weights of the cost.
        """
        self.stages = len(knots) - 1
        self.limits = limits
        self.weights = weights
        self.packed = pack_objective(knots, limits, weights)
        """Argument of the kernels (problem_data.py)."""
        self.state_scale = np.concatenate([limits.state_scale, limits.thrust_scale])
        """(8,) scales S of the states."""
        self.equalities = self.stages * STATES + 2
        """Number of equality rows; they are the first ones."""
        self._lay_out(0)

    def match(self, lin: Linearisation) -> bool:
        """Lay out the QP again if a linearisation has another number of half-planes: a fence was set or removed.

        ``build`` does this by itself; a solver that calls ``fill`` with arrays of its own calls it before.

        Parameters
        ----------
        lin : the linearisation of the next problem.

        Returns
        -------
        True if the layout has changed: arrays of ``allocate`` and a solver's workspace are then of the wrong size.
        """
        if lin.rows.shape[1] == self.half_planes:
            return False
        self._lay_out(lin.rows.shape[1])
        return True

    def _lay_out(self, half_planes: int) -> None:
        """Compute all that depends on the number of half-planes in each stage."""
        self.half_planes = half_planes
        self.variables = self.stages * (STAGE_VARIABLES + len(self.limits.limited_states) + half_planes) + 2
        """Number of columns n."""
        lengths = np.diff(unpack_objective(self.packed).t)
        self.P = _hessian(lengths, self.limits, self.weights, self.variables)
        self._place_entries()

    def _place_entries(self) -> None:
        """Place the entries of A among the stored ones, which are ordered by column."""
        N, limited = self.stages, self.limits.limited_states
        excess, bound = self.variables - N * self.half_planes, self.equalities + N * (4 + 3 * len(limited))
        constant = _constant_entries(N, limited) + _excess_entries(N * self.half_planes, excess, bound)
        jacobian = _jacobian_entries(N, self.state_scale, self.limits.thrust_scale)
        end = (N - 1) * STAGE_VARIABLES + 2
        velocity = [(N * STATES + i, end + j) for i in range(2) for j in range(3)]
        normals = [
            (bound + 2 * (k * self.half_planes + j), k * STAGE_VARIABLES + i)
            for k in range(N)
            for j in range(self.half_planes)
            for i in range(2)
        ]
        at = [entry[:2] for entry in constant] + [entry[:2] for entry in jacobian] + velocity + normals
        row, column = np.array(at, dtype=np.int32).T  # OSQP's own type
        shape = (bound + 2 * N * self.half_planes, self.variables)
        numbered = csc_array(coo_array((np.arange(1.0, len(at) + 1.0), (row, column)), shape=shape))
        place = np.argsort(numbered.data)
        self.pattern = numbered
        """(m, n) sparsity pattern of A; its numbers mean nothing."""
        self._constants = np.zeros(len(at))
        self._constants[place[: len(constant)]] = [entry[2] for entry in constant]
        middle = slice(len(constant), len(constant) + len(jacobian))
        self.entries = EntryMap(
            place[middle].astype(np.int64),
            np.array([entry[2] for entry in jacobian], dtype=np.int64),
            np.array([entry[3] for entry in jacobian]),
            place[middle.stop : middle.stop + len(velocity)].astype(np.int64),
            place[middle.stop + len(velocity) :].astype(np.int64),
            numbered.indices.astype(np.int64),
        )

    @property
    def rows(self) -> int:
        """Number of rows m."""
        return int(self.pattern.shape[0])

    @property
    def row_names(self) -> tuple[ConstraintRow, ...]:
        """Name, scale and unit of each row."""
        stages, thrusts = range(1, self.stages + 1), self.limits.thrust_scale
        return (
            *rows.dynamics(stages, self.state_scale),
            *rows.terminal_velocity(),
            *rows.slew(stages, thrusts),
            *rows.box(stages, thrusts),
            *rows.motion_limits(stages, self.limits.limited_states, self.state_scale),
            *rows.half_planes(stages, self.half_planes, float(self.state_scale[0])),
        )

    def allocate(self) -> QpNumbers:
        """Return arrays for a cycle's numbers, with those entries of A that never change."""
        return QpNumbers(self._constants.copy(), np.zeros(self.variables), np.zeros(self.rows), np.zeros(self.rows))

    def build(self, lin: Linearisation, target: Array) -> QP:
        """Return the QP of one cycle, with a row for each half-plane of the linearisation.

        Parameters
        ----------
        lin : the motion along the nominal trajectory.
        target : (N+1, 3) as in ``Solver.build``.

        Returns
        -------
        The QP, its rows not scaled by any solver.
        """
        self.match(lin)
        numbers = self.allocate()
        fill(self.packed, lin, np.ascontiguousarray(target), self.entries, numbers)
        return self.assemble(numbers)

    def assemble(self, numbers: QpNumbers) -> QP:
        """Return the QP that has these numbers; it shares their memory.

        Parameters
        ----------
        numbers : entries of A (in the order of ``pattern``), q (n,), l and u (m,), all without a unit.
        """
        pattern = self.pattern
        A = csc_array((numbers.A, pattern.indices, pattern.indptr), shape=pattern.shape)
        return QP(self.P, numbers.q, A, numbers.l, numbers.u)

    def commands(self, lin: Linearisation, x: Array) -> Array:
        """Return the commands of a solution.

        Parameters
        ----------
        lin : the linearisation that the QP was built from.
        x : (n,) primal solution.

        Returns
        -------
        (N+1, 2) port and starboard thrust at the knots (N); the first row is the command in force.
        """
        U = lin.U.copy()
        stages = x[: self.stages * STAGE_VARIABLES].reshape(self.stages, STAGE_VARIABLES)
        U[1:] += stages[:, STATES:] * self.limits.thrust_scale
        return U


def _hessian(lengths: Array, limits: HorizonLimits, weights: Weights, variables: int) -> csc_array:
    """Return P (n, n); ``lengths`` (N,) of the stages in first stages."""
    N, r = len(lengths), weights.thrust * lengths[:, None]
    s = weights.thrust_change / lengths[:, None]
    position = weights.position_per_m2 * lengths
    position[-1] += weights.terminal_position_per_m2
    diagonal = np.zeros((N, STAGE_VARIABLES))
    diagonal[:, :2] = position[:, None] * limits.state_scale[:2] ** 2
    diagonal[:, 4] = weights.heading_per_rad2 * lengths * limits.state_scale[4] ** 2
    # r_k |U_k|^2 + s_k |U_k - U_(k-1)|^2 + s_(k+1) |U_(k+1) - U_k|^2, the last one without a successor
    diagonal[:, STATES:] = r + s
    diagonal[:-1, STATES:] += s[1:]
    between = np.zeros((N - 1, STAGE_VARIABLES))
    between[:, STATES:] = -s[1:]
    at = np.arange(N * STAGE_VARIABLES, dtype=np.int32)
    last = N * STAGE_VARIABLES + np.arange(2, dtype=np.int32)
    row = np.concatenate([at, at[:-STAGE_VARIABLES], at[STAGE_VARIABLES:], last])
    column = np.concatenate([at, at[STAGE_VARIABLES:], at[:-STAGE_VARIABLES], last])
    end = np.full(2, weights.terminal_velocity_s2_per_m2)
    values = np.concatenate([diagonal.ravel(), between.ravel(), between.ravel(), end])
    stored = values != 0.0
    return csc_array(coo_array((values[stored], (row[stored], column[stored])), shape=(variables, variables)))


def _constant_entries(N: int, limited: tuple[int, ...]) -> list[tuple[int, int, float]]:
    """Return row, column and value of the entries of A that are the same in every cycle."""
    E = N * STATES + 2
    entries = []
    for k in range(N):
        here = k * STAGE_VARIABLES
        entries += [(k * STATES + i, here + i, -1.0) for i in range(STATES)]
        for i in range(2):
            slew, box, command = E + 2 * k + i, E + 2 * (N + k) + i, here + STATES + i
            entries += [(slew, command, 1.0), (box, command, 1.0)]
            if k > 0:
                entries.append((slew, command - STAGE_VARIABLES, -1.0))
    excess, row = N * STAGE_VARIABLES + 2, E + 4 * N
    for k in range(N):
        for i in limited:
            state = k * STAGE_VARIABLES + i
            entries += [(row, state, 1.0), (row, excess, -1.0)]
            entries += [(row + 1, state, 1.0), (row + 1, excess, 1.0)]
            entries.append((row + 2, excess, 1.0))
            excess, row = excess + 1, row + 3
    entries += [(N * STATES + i, N * STAGE_VARIABLES + i, -1.0) for i in range(2)]
    return entries


def _excess_entries(count: int, column: int, row: int) -> list[tuple[int, int, float]]:
    """Return the entries of the half-planes' excesses, from a column and a row on."""
    bounds = [(row + 2 * i, column + i, 1.0) for i in range(count)]
    return bounds + [(row + 2 * i + 1, column + i, 1.0) for i in range(count)]


def _jacobian_entries(N: int, state_scale: Array, thrust_scale: Array) -> list[tuple[int, int, float, float]]:
    """Return row, column, index in the linearisation's storage and factor of the entries that it gives."""
    # A linearisation that holds, instead of its numbers, the index of each.
    index = unpack_linearisation(np.arange(float(storage_size(N))), N)
    per_state = state_scale[None, :] / state_scale[:, None]
    per_thrust = thrust_scale[None, :] / state_scale[:, None]
    entries = []
    for k in range(N):
        before, here = (k - 1) * STAGE_VARIABLES, k * STAGE_VARIABLES
        for i in range(STATES):
            row = k * STATES + i
            for j in range(2):
                if THRUST_PATTERN[i, j]:
                    entries.append((row, here + STATES + j, index.B1[k, i, j], per_thrust[i, j]))
                    if k > 0:
                        entries.append((row, before + STATES + j, index.B0[k, i, j], per_thrust[i, j]))
            if k > 0:
                entries += [
                    (row, before + j, index.A[k, i, j], per_state[i, j]) for j in range(STATES) if STATE_PATTERN[i, j]
                ]
    return entries


@jit
def fill(packed: Array, lin: Linearisation, target: Array, entries: EntryMap, to: QpNumbers) -> None:
    """Compute one cycle's numbers of the QP.

    Parameters
    ----------
    packed : a packed objective (problem_data.py).
    lin : the motion along the nominal trajectory; its number of half-planes is that of the layout
        (``SparseQp.match``), because compiled code does not check bounds.
    target : (N+1, 3) as in ``Solver.build``.
    entries : ``SparseQp.entries``.
    to : is overwritten; made by ``SparseQp.allocate``.
    """
    N = len(target) - 1
    objective = unpack_objective(packed)
    X, U, F = lin.X, lin.U, objective.thrust_scale
    data, q, l, u = to.A, to.q, to.l, to.u  # noqa: E741
    for i in range(len(entries.place)):
        data[entries.place[i]] = lin.flat[entries.source[i]] * entries.factor[i]
    velocity, slope = velocity_over_ground(X[N], lin.C[N])
    E = N * STATES + 2
    for k in range(N):
        row, column = k * STATES, k * STAGE_VARIABLES
        g = stage_length(objective, k + 1)
        r, s = objective.thrust * g, objective.thrust_change / g
        for i in range(STATES):
            # -dX_(k+1) + A dX_k + B0 dU_k + B1 dU_(k+1) = Xbar_(k+1) - Phi_k
            scale = state_scale(i, objective)
            l[row + i] = u[row + i] = (X[k + 1, i] - lin.Phi[k, i]) / scale
            q[column + i] = 0.0
        q[column + 4] = heading_slope(X, target, k + 1, objective) * objective.state_scale[4]
        weight = objective.position * g + (objective.terminal_position if k == N - 1 else 0.0)
        for i in range(2):
            # w_k (p_k - ref_k)
            q[column + i] = weight * (X[k + 1, i] - target[k, i]) * objective.state_scale[i]
            # r U_k + s (U_k - U_(k-1)) - s (U_(k+1) - U_k)
            step = (U[k + 1, i] - U[k, i]) / F[i]
            q[column + STATES + i] = r * U[k + 1, i] / F[i] + s * step
            if k > 0:
                q[column - STAGE_VARIABLES + STATES + i] -= s * step
            slew, box = E + 2 * k + i, E + 2 * (N + k) + i
            # slew:  -slew h <= (Ubar_(k+1) - Ubar_k) + (dU_(k+1) - dU_k) <= slew h
            change = g * objective.max_change[i]
            l[slew], u[slew] = -change / F[i] - step, change / F[i] - step
            # box:  low <= Ubar_(k+1) + dU_(k+1) <= high
            low, high = command_bounds(
                U[0, i], objective.t[k + 1] * objective.max_change[i], objective.low[i], objective.high[i]
            )
            l[box], u[box] = (low - U[k + 1, i]) / F[i], (high - U[k + 1, i]) / F[i]
    _fill_soft_limits(objective, lin, excess_penalty(X, target, objective), entries, to)
    for i in range(2):
        # -(p'_N - ref'_N) + V dX_N = ref'_N - p'bar_N
        l[N * STATES + i] = u[N * STATES + i] = target[N, i] - velocity[i]
        q[N * STAGE_VARIABLES + i] = 0.0
        for j in range(3):
            data[entries.velocity[3 * i + j]] = slope[i, j] * objective.state_scale[2 + j]


@jit
def _fill_soft_limits(
    objective: Objective, lin: Linearisation, penalty: float, entries: EntryMap, to: QpNumbers
) -> None:
    """Compute the numbers of the limits of the motion and of the half-planes."""
    N, X = lin.U.shape[0] - 1, lin.X
    data, q, l, u = to.A, to.q, to.l, to.u  # noqa: E741
    E = N * STATES + 2
    excess, row = N * STAGE_VARIABLES + 2, E + 4 * N
    for k in range(N):
        for j in range(2):
            if is_limited(objective, j):
                i = LIMITED_STATES[j]
                scale = objective.state_scale[i]
                l[row], u[row] = -NO_BOUND, min((objective.high_state[j] - X[k + 1, i]) / scale, NO_BOUND)
                l[row + 1], u[row + 1] = max((objective.low_state[j] - X[k + 1, i]) / scale, -NO_BOUND), NO_BOUND
                l[row + 2], u[row + 2] = 0.0, NO_BOUND
                q[excess] = penalty * stage_length(objective, k + 1)
                excess, row = excess + 1, row + 3
    for k in range(N):
        for j in range(lin.rows.shape[1]):
            for i in range(2):
                at = entries.normal[2 * (k * lin.rows.shape[1] + j) + i]
                data[at] = lin.rows[k, j, i] * objective.state_scale[i]
            l[row], u[row] = max(lin.rows[k, j, 2], -NO_BOUND), NO_BOUND
            l[row + 1], u[row + 1] = 0.0, NO_BOUND
            q[excess] = lin.rows[k, j, 3]
            excess, row = excess + 1, row + 2


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
    The QP in scaled deviations from X and U; the head of ``ltv_mpc/control/qp/sparse.py`` lists its rows and columns.
    """
    stage_s = STAGE_NS * 1e-9
    lin = linearise(X, U, current, stage_s, vehicle.coefficients())
    limits = HorizonLimits.from_vehicle(vehicle, stage_s)
    form = SparseQp(np.arange(float(len(U))), limits, weights or default_weights(vehicle))
    return form.build(lin, np.vstack([reference, end_velocity_mps]))
