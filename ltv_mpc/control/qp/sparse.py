"""The sparse QP of the LTV-MPC, in deviations from the trajectory that it was linearised along.

    minimise   sum over k = 1..N of   g_k (w |p_k - ref_k|^2 + r |U_k / F|^2) + s / g_k |(U_k - U_(k-1)) / F|^2
               + w_N |p_N - ref_N|^2 + m |p'_N - ref'_N|^2
    subject to dX_(k+1) = A_k dX_k + B0_k dU_k + B1_k dU_(k+1) + Phi_k - Xbar_(k+1),   dX_0 = 0, dU_0 = 0
               p'_N = V dX_N + p'bar_N
               min <= Ubar_k + dU_k <= max,   |U_k - U_(k-1)| <= slew h_k

and for each state x that has a limit (horizon_limits.py), with the cost  g_k c e_k / S  of its excess e_k,

               xbar_k + dx_k - e_k <= most,   xbar_k + dx_k + e_k >= -most,   e_k >= 0

g_k = h_k / 0.3 s: the length of the stage that ends at knot k (shooting_grid.py). p = [n, e], p' its velocity over
ground; F the
thrusters' largest thrust; dX = X - Xbar. The terminal velocity is what tells a vehicle that stops on its point from one
that passes, or orbits, it: within a short horizon both are as near. The sparsity pattern is fixed by N: only numbers
change from cycle to cycle.

Variables are scaled to be of order one, z_k = [dX_k / S, dU_k / F] and p'_N - ref'_N at the end; the rows of the
dynamics are divided by the same scales. S comes from the vehicle (scaling.py), its last two are F. What else a solver
wants of its rows is the solver's own business.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csc_array

from ltv_mpc.control.config import STAGE_NS, Weights
from ltv_mpc.control.horizon_limits import LIMITED_STATES, PENALTY, HorizonLimits, command_bounds
from ltv_mpc.control.linearisation import Linearisation, linearise, size, velocity_over_ground, views
from ltv_mpc.control.problem_data import pack_objective, stage_length, state_scale, unpack_objective
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
"""Which entries of A can be other than zero: positions carry over and depend on the rest; thrust on itself."""
STATE_PATTERN[:, :2] = False
STATE_PATTERN[6:, :] = False
np.fill_diagonal(STATE_PATTERN, True)

THRUST_PATTERN = np.ones((STATES, 2), dtype=bool)
"""Which entries of B0 and B1 can be other than zero."""
THRUST_PATTERN[6, 1] = THRUST_PATTERN[7, 0] = False


NO_BOUND = 1e3
"""A bound that is none, in units of the QP: hundreds of m/s. Finite: not every solver takes an infinite one well."""


class EntryMap(NamedTuple):
    """Where numbers go: A_data[place] = flat[source] * scale, and the slope of the velocity at the end."""

    place: Indices
    source: Indices
    velocity: Indices  # (6,)
    row_of: Indices  # (nnz,) the row of each stored entry of A


@jit
def unpack_map(flat: Indices, entries: int) -> EntryMap:
    """The parts of a flat array, as ``SparseQp.map`` holds them."""
    taken = (len(flat) - 6 - entries) // 2
    return EntryMap(flat[:taken], flat[taken : 2 * taken], flat[2 * taken : 2 * taken + 6], flat[2 * taken + 6 :])


class SparseQp:
    """The layout for given knots: where each number of a cycle goes.

    Columns: 10 a stage (the state at its end, both commands there), then the terminal velocity, then an excess of each
    limited state a stage. Rows: 8 of dynamics a stage, 2 of the terminal velocity (these are the ``equalities``), then
    2 of slew a stage, 2 of box a stage, and 3 of each limited state a stage.
    """

    def __init__(self, knots: Array, limits: HorizonLimits, weights: Weights) -> None:
        """``knots`` (N+1,) as in ``shooting_grid.py``, ``limits`` and ``weights`` fix P; A, q, l and u change every
        cycle.
        """
        self.stages = stages = len(knots) - 1
        self._lengths = np.diff(knots)
        self.limits = limits
        self.weights = weights
        position = weights.position_per_m2 * self._lengths
        position[-1] += weights.terminal_position_per_m2
        self.limited = limits.limited
        self.variables = stages * STAGE_VARIABLES + 2 + stages * len(self.limited)
        self.equalities = stages * STATES + 2
        self.rows = self.equalities + 4 * stages + 3 * stages * len(self.limited)
        self._position = position
        self.numbers = pack_objective(knots, limits, weights)
        self.state_scale = np.concatenate([limits.state_scale, limits.scale])
        self.P = self._cost()
        self._make_pattern()

    # --- the cost ---

    def _cost(self) -> csc_array:
        N, r = self.stages, self.weights.thrust * self._lengths[:, None]
        s = self.weights.thrust_change / self._lengths[:, None]
        diagonal = np.zeros((N, STAGE_VARIABLES))
        diagonal[:, :2] = self._position[:, None] * self.limits.state_scale[:2] ** 2
        # r_k |U_k|^2 + s_k |U_k - U_(k-1)|^2 + s_(k+1) |U_(k+1) - U_k|^2, the last one without a successor
        diagonal[:, STATES:] = r + s
        diagonal[:-1, STATES:] += s[1:]
        between = np.zeros((N - 1, STAGE_VARIABLES))
        between[:, STATES:] = -s[1:]
        at = np.arange(N * STAGE_VARIABLES, dtype=np.int32)
        last = N * STAGE_VARIABLES + np.arange(2, dtype=np.int32)
        rows = np.concatenate([at, at[:-STAGE_VARIABLES], at[STAGE_VARIABLES:], last])
        columns = np.concatenate([at, at[STAGE_VARIABLES:], at[:-STAGE_VARIABLES], last])
        end = np.full(2, self.weights.terminal_velocity_s2_per_m2)
        values = np.concatenate([diagonal.ravel(), between.ravel(), between.ravel(), end])
        there = values != 0.0
        return csc_array(coo_array((values[there], (rows[there], columns[there])), shape=(self.variables,) * 2))

    # --- the constraints ---

    def _make_pattern(self) -> None:
        """Which entry of A is which number of the linearisation: entries are numbered, and found again in columns."""
        N, E = self.stages, self.equalities
        # A linearisation that holds, instead of its numbers, where each of them lies.
        where = views(np.arange(float(size(N))), N)
        per_state = self.state_scale[None, :] / self.state_scale[:, None]
        per_thrust = self.limits.scale[None, :] / self.state_scale[:, None]
        fixed: list[tuple[int, int, float]] = []  # row, column, number
        taken: list[tuple[int, int, float, float]] = []  # row, column, where from, scale
        for k in range(N):
            before, here = (k - 1) * STAGE_VARIABLES, k * STAGE_VARIABLES
            for i in range(STATES):
                row = k * STATES + i
                fixed.append((row, here + i, -1.0))
                for j in range(2):
                    if THRUST_PATTERN[i, j]:
                        taken.append((row, here + STATES + j, where.B1[k, i, j], per_thrust[i, j]))
                        if k > 0:
                            taken.append((row, before + STATES + j, where.B0[k, i, j], per_thrust[i, j]))
                taken += [
                    (row, before + j, where.A[k, i, j], per_state[i, j])
                    for j in range(STATES)
                    if k > 0 and STATE_PATTERN[i, j]
                ]
            for j in range(2):
                slew, box = E + k * 2 + j, E + (N + k) * 2 + j
                fixed += [(slew, here + STATES + j, 1.0), (box, here + STATES + j, 1.0)]
                if k > 0:
                    fixed.append((slew, before + STATES + j, -1.0))
        excess, row = N * STAGE_VARIABLES + 2, E + 4 * N
        for k in range(N):
            for i in self.limited:
                fixed += [
                    (row, k * STAGE_VARIABLES + i, 1.0),
                    (row, excess, -1.0),
                    (row + 1, k * STAGE_VARIABLES + i, 1.0),
                ]
                fixed += [(row + 1, excess, 1.0), (row + 2, excess, 1.0)]
                excess, row = excess + 1, row + 3
        end = (N - 1) * STAGE_VARIABLES + 2
        velocity = [(N * STATES + i, end + j) for i in range(2) for j in range(3)]
        fixed += [(N * STATES + i, N * STAGE_VARIABLES + i, -1.0) for i in range(2)]
        at = [entry[:2] for entry in fixed] + [entry[:2] for entry in taken] + velocity
        rows, columns = np.array(at, dtype=np.int32).T  # OSQP's own type
        numbered = csc_array(
            coo_array((np.arange(1.0, len(at) + 1.0), (rows, columns)), shape=(self.rows, self.variables))
        )
        place = np.argsort(numbered.data)
        self._template = np.zeros(len(at))
        self._template[place[: len(fixed)]] = [entry[2] for entry in fixed]
        middle = slice(len(fixed), len(fixed) + len(taken))
        source = np.array([entry[2] for entry in taken], dtype=np.int64)
        self.pattern = numbered
        """Of A; its numbers mean nothing."""
        self.map: Indices = np.concatenate([place[middle], source, place[middle.stop :], numbered.indices]).astype(
            np.int64
        )
        self.factor = np.array([entry[3] for entry in taken])

    @cached_property
    def row_names(self) -> tuple[ConstraintRow, ...]:
        """What each row is."""
        stages, thrusts = range(1, self.stages + 1), self.limits.scale
        return (
            *rows.dynamics(stages, self.state_scale),
            *rows.terminal_velocity(),
            *rows.slew(stages, thrusts),
            *rows.box(stages, thrusts),
            *rows.motion(stages, self.limited, self.state_scale),
        )

    def template(self) -> Array:
        """Room for A's numbers (nnz,), with those in it that never change."""
        return self._template.copy()

    def fill(self, lin: Linearisation, target: Array, A_data: Array, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """One cycle's numbers into A_data (nnz,), made by ``template``, q (n,), l and u (m,)."""
        fill(self.numbers, lin.flat, target, self.map, self.factor, A_data, q, l, u)

    def build(self, lin: Linearisation, target: Array) -> QP:
        """The QP of one cycle; ``target`` (N+1, 2) as in ``Solver``."""
        A_data, q = self.template(), np.empty(self.variables)
        lower, upper = np.empty(self.rows), np.empty(self.rows)
        self.fill(lin, np.ascontiguousarray(target), A_data, q, lower, upper)
        return self.assemble(A_data, q, lower, upper)

    def assemble(self, A_data: Array, q: Array, l: Array, u: Array) -> QP:  # noqa: E741
        """Numbers of this form as a QP."""
        A = csc_array((A_data, self.pattern.indices, self.pattern.indptr), shape=self.pattern.shape)
        return QP(self.P, q, A, l, u)

    def commands(self, lin: Linearisation, x: Array) -> Array:
        """Commands (N+1, 2) at the knots of a solution x (n,)."""
        U = lin.U.copy()
        U[1:] += (
            x[: self.stages * STAGE_VARIABLES].reshape(self.stages, STAGE_VARIABLES)[:, STATES:] * self.limits.scale
        )
        return U


@jit
def fill(
    numbers: Array,
    flat: Array,
    target: Array,
    places: Indices,
    factor: Array,
    data: Array,
    q: Array,
    l: Array,  # noqa: E741
    u: Array,
) -> None:
    """What ``SparseQp.fill`` does."""
    N = len(target) - 1
    lin, c = views(flat, N), unpack_objective(numbers)
    X, U, F = lin.X, lin.U, c.scale
    to = unpack_map(places, len(data))
    for i in range(len(to.place)):
        data[to.place[i]] = flat[to.source[i]] * factor[i]
    velocity, slope = velocity_over_ground(X[N], lin.C[N])
    E = N * STATES + 2
    for k in range(N):
        row, column = k * STATES, k * STAGE_VARIABLES
        g = stage_length(c, k + 1)
        r, s = c.thrust * g, c.thrust_change / g
        for i in range(STATES):
            # -dX_(k+1) + A dX_k + B0 dU_k + B1 dU_(k+1) = Xbar_(k+1) - Phi_k
            scale = state_scale(i, c)
            l[row + i] = u[row + i] = (X[k + 1, i] - lin.Phi[k, i]) / scale
            q[column + i] = 0.0
        weight = c.position * g + (c.terminal_position if k == N - 1 else 0.0)
        for i in range(2):
            # w_k (p_k - ref_k)
            q[column + i] = weight * (X[k + 1, i] - target[k, i]) * c.state_scale[i]
            # r U_k + s (U_k - U_(k-1)) - s (U_(k+1) - U_k)
            step = (U[k + 1, i] - U[k, i]) / F[i]
            q[column + STATES + i] = r * U[k + 1, i] / F[i] + s * step
            if k > 0:
                q[column - STAGE_VARIABLES + STATES + i] -= s * step
            slew, box = E + 2 * k + i, E + 2 * (N + k) + i
            low, high = command_bounds(U[0, i], c.t[k + 1] * c.max_change[i], c.low[i], c.high[i])
            change = g * c.max_change[i]
            l[slew], u[slew] = -change / F[i] - step, change / F[i] - step
            l[box], u[box] = (low - U[k + 1, i]) / F[i], (high - U[k + 1, i]) / F[i]
    excess, row = N * STAGE_VARIABLES + 2, E + 4 * N
    for k in range(N):
        for j in range(2):
            if np.isfinite(c.max_state[j]):
                i = LIMITED_STATES[j]
                scale = c.state_scale[i]
                l[row], u[row] = -NO_BOUND, (c.max_state[j] - X[k + 1, i]) / scale
                l[row + 1], u[row + 1] = (-c.max_state[j] - X[k + 1, i]) / scale, NO_BOUND
                l[row + 2], u[row + 2] = 0.0, NO_BOUND
                q[excess] = PENALTY * stage_length(c, k + 1)
                excess, row = excess + 1, row + 3
    for i in range(2):
        # -(p'_N - ref'_N) + V dX_N = ref'_N - p'bar_N
        l[N * STATES + i] = u[N * STATES + i] = target[N, i] - velocity[i]
        q[N * STAGE_VARIABLES + i] = 0.0
        for j in range(3):
            data[to.velocity[3 * i + j]] = slope[i, j] * c.state_scale[2 + j]


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
    """The QP of one cycle, linearised along a trajectory.

    ``X`` (N+1, 8) states n, e, u, v, psi, r and delivered port and starboard thrust; ``U`` (N+1, 2) their commands;
    ``current`` (N+1, 2) north and east (m/s), all at knots 0.3 s apart; ``reference`` (N, 2) north and east (m) wanted
    at the knots 1 .. N, and ``end_velocity_mps`` over ground at the last. Its unknowns are scaled deviations from X and
    U in the order of the stages: this file's head.
    """
    stage_s = STAGE_NS * 1e-9
    lin = linearise(X, U, current, stage_s, vehicle.coefficients())
    form = SparseQp(
        np.arange(float(len(U))), HorizonLimits.from_vehicle(vehicle, stage_s), weights or default_weights(vehicle)
    )
    return form.build(lin, np.vstack([reference, end_velocity_mps]))
