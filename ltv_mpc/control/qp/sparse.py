"""The sparse QP of the LTV-MPC, in deviations from the trajectory that it was linearised along.

    minimise   sum over k = 1..N of   w |p_k - ref_k|^2 + r |U_k / F|^2 + s |(U_k - U_(k-1)) / F|^2
               + w_N |p_N - ref_N|^2 + m |p'_N|^2
    subject to dX_(k+1) = A_k dX_k + B0_k dU_k + B1_k dU_(k+1) + Phi_k - Xbar_(k+1),   dX_0 = 0, dU_0 = 0
               p'_N = V dX_N + p'bar_N
               min <= Ubar_k + dU_k <= max,   |U_k - U_(k-1)| <= slew h

p = [n, e], p' its velocity over ground; F the thrusters' largest thrust; dX = X - Xbar. The terminal velocity is what
tells a vehicle that stops on its point from one that passes, or orbits, it: within a short horizon both are as near.
The sparsity pattern is fixed by N: only numbers change from cycle to cycle.

Variables are scaled to be of order one, z_k = [dX_k / STATE_SCALE, dU_k / F] and p'_N at the end. Rows are scaled by
kind: OSQP's one step size rho acts on a row multiplied by s as rho s^2, and equalities want 1e4 to 1e5 times that of
box and slew. With all this done here, OSQP's own scaling stays off, and a solve has no memory.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csc_array

from ltv_mpc.control.config import STAGE_NS, Weights
from ltv_mpc.control.horizon import Linearisation, linearise, velocity_over_ground
from ltv_mpc.control.limits import ThrustLimits
from ltv_mpc.control.qp.problem import QP
from ltv_mpc.signals import Array
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Vehicle

WIDTH = STATES + 2
"""Variables a stage: the state at its end and both commands there."""

STATE_SCALE = np.array([1.0, 1.0, 0.3, 0.3, 1.0, 0.3])
"""n, e (m), u, v (m/s), psi (rad), r (rad/s); the two thrusts are scaled by their limits."""

DYNAMICS_ROW = 300.0
"""Row scale of the equalities: rho 300 squared times that of box and slew."""

STATE_PATTERN = np.ones((STATES, STATES), dtype=bool)
"""Which entries of A can be other than zero: positions carry over and depend on the rest; thrust on itself."""
STATE_PATTERN[:, :2] = False
STATE_PATTERN[6:, :] = False
np.fill_diagonal(STATE_PATTERN, True)

THRUST_PATTERN = np.ones((STATES, 2), dtype=bool)
"""Which entries of B0 and B1 can be other than zero."""
THRUST_PATTERN[6, 1] = THRUST_PATTERN[7, 0] = False


class SparseForm:
    """The layout for N stages: where each number of a cycle goes."""

    def __init__(self, stages: int, limits: ThrustLimits, weights: Weights) -> None:
        """``limits`` and ``weights`` fix P; only q, A's numbers, l and u change from cycle to cycle."""
        self.stages = stages
        self.limits = limits
        self.weights = weights
        self._scale = np.concatenate([STATE_SCALE, limits.scale])  # (8,) of a state
        self._thrust_scale = limits.scale
        position = np.full(stages, weights.position_per_m2)
        position[-1] += weights.terminal_position_per_m2
        self._position_weight = position
        self.variables = stages * WIDTH + 2
        self.rows = stages * (STATES + 4) + 2
        self.P = self._cost()
        self._make_pattern()

    # --- the cost ---

    def _cost(self) -> csc_array:
        N, r, s = self.stages, self.weights.thrust, self.weights.thrust_change
        diagonal = np.zeros((N, WIDTH))
        diagonal[:, :2] = self._position_weight[:, None] * STATE_SCALE[:2] ** 2
        # r |U_k|^2 + s |U_k - U_(k-1)|^2 + s |U_(k+1) - U_k|^2, the last one without a successor
        diagonal[:, STATES:] = r + 2.0 * s
        diagonal[-1, STATES:] = r + s
        between = np.zeros((N - 1, WIDTH))
        between[:, STATES:] = -s
        at = np.arange(N * WIDTH)
        last = N * WIDTH + np.arange(2)
        rows = np.concatenate([at, at[:-WIDTH], at[WIDTH:], last])
        columns = np.concatenate([at, at[WIDTH:], at[:-WIDTH], last])
        end = np.full(2, self.weights.terminal_velocity_s2_per_m2)
        values = np.concatenate([diagonal.ravel(), between.ravel(), between.ravel(), end])
        there = values != 0.0
        return csc_array(coo_array((values[there], (rows[there], columns[there])), shape=(self.variables,) * 2))

    def _gradient(self, lin: Linearisation, reference: Array) -> Array:
        """q (n,): the cost's gradient at zero deviation."""
        q = np.zeros((self.stages, WIDTH))
        # w_k (p_k - ref_k)
        q[:, :2] = self._position_weight[:, None] * (lin.X[1:, :2] - reference) * STATE_SCALE[:2]
        U = lin.U / self._thrust_scale
        # r U_k + s (U_k - U_(k-1)) - s (U_(k+1) - U_k)
        step = np.diff(U, axis=0)
        q[:, STATES:] = self.weights.thrust * U[1:] + self.weights.thrust_change * step
        q[:-1, STATES:] -= self.weights.thrust_change * step[1:]
        return np.concatenate([q.ravel(), np.zeros(2)])

    # --- the constraints ---

    def _make_pattern(self) -> None:
        """Rows: 8 of dynamics a stage, 2 of the terminal velocity, then 2 of slew a stage, then 2 of box a stage.

        Each entry is (row, column, source): source is its place in the vector of all values that ``build`` makes,
        [1, -1, A (N, 8, 8), B0 (N, 8, 2), B1 (N, 8, 2), V (2, 3)].
        """
        N = self.stages
        one, minus_one = 0, 1
        A = 2 + np.arange(N * STATES * STATES).reshape(N, STATES, STATES)
        B0 = 2 + A.size + np.arange(N * STATES * 2).reshape(N, STATES, 2)
        B1 = B0 + B0.size
        V = 2 + A.size + B0.size + B1.size + np.arange(6).reshape(2, 3)
        equalities = N * STATES + 2
        entries: list[tuple[int, int, int]] = []
        for k in range(N):
            before, here = (k - 1) * WIDTH, k * WIDTH
            for i in range(STATES):
                row = k * STATES + i
                entries.append((row, here + i, minus_one))
                entries += [(row, here + STATES + j, B1[k, i, j]) for j in range(2) if THRUST_PATTERN[i, j]]
                if k > 0:
                    entries += [(row, before + j, A[k, i, j]) for j in range(STATES) if STATE_PATTERN[i, j]]
                    entries += [(row, before + STATES + j, B0[k, i, j]) for j in range(2) if THRUST_PATTERN[i, j]]
            for j in range(2):
                slew, box = equalities + k * 2 + j, equalities + (N + k) * 2 + j
                entries += [(slew, here + STATES + j, one), (box, here + STATES + j, one)]
                if k > 0:
                    entries.append((slew, before + STATES + j, minus_one))
        for i in range(2):
            entries.append((N * STATES + i, N * WIDTH + i, minus_one))
            entries += [(N * STATES + i, (N - 1) * WIDTH + 2 + j, V[i, j]) for j in range(3)]
        rows, columns, source = np.array(entries, dtype=np.int64).T
        # Numbering the entries tells where each of them ends up in compressed columns.
        numbered = csc_array(
            coo_array((np.arange(1.0, len(rows) + 1.0), (rows, columns)), shape=(self.rows, self.variables))
        )
        order = numbered.data.astype(np.int64) - 1
        row_scale = np.where(rows < equalities, DYNAMICS_ROW, 1.0)
        self._source: npt.NDArray[np.int64] = source[order]
        self._entry_scale: Array = row_scale[order]
        self._pattern = numbered

    def build(self, lin: Linearisation, reference: Array) -> QP:
        """The QP of one cycle; ``reference`` is (N, 2): north and east (m) wanted at the knots 1 .. N."""
        N = self.stages
        state, thrust = self._scale, self._thrust_scale
        # rows divided by, columns multiplied by the scales of their variables
        A = lin.A * (state[None, :] / state[:, None])
        B0 = lin.B0 * (thrust[None, :] / state[:, None])
        B1 = lin.B1 * (thrust[None, :] / state[:, None])
        velocity, slope = velocity_over_ground(lin.X[-1], lin.C[-1])
        V = slope * state[2:5]
        values = np.concatenate([[1.0, -1.0], A.ravel(), B0.ravel(), B1.ravel(), V.ravel()])
        A_data = values[self._source] * self._entry_scale
        # -dX_(k+1) + A dX_k + B0 dU_k + B1 dU_(k+1) = Xbar_(k+1) - Phi_k
        gap = np.concatenate([((lin.X[1:] - lin.Phi) / state).ravel(), -velocity]) * DYNAMICS_ROW
        step = np.diff(lin.U, axis=0)
        change = self.limits.change
        low, high = self.limits.box(lin.U[0], N)
        lower = np.concatenate([gap, ((-change - step) / thrust).ravel(), ((low - lin.U[1:]) / thrust).ravel()])
        upper = np.concatenate([gap, ((change - step) / thrust).ravel(), ((high - lin.U[1:]) / thrust).ravel()])
        pattern = self._pattern
        A_matrix = csc_array((A_data, pattern.indices, pattern.indptr), shape=pattern.shape)
        return QP(self.P, self._gradient(lin, reference), A_matrix, lower, upper)

    # --- back to the vehicle ---

    def commands(self, lin: Linearisation, x: Array) -> Array:
        """Commands (N+1, 2) at the knots of a solution x (n,)."""
        U = lin.U.copy()
        U[1:] += x[:-2].reshape(self.stages, WIDTH)[:, STATES:] * self._thrust_scale
        return U

    def shifted_dual(self, y: Array, stages: float) -> Array:
        """A dual y (m,) for a grid that begins ``stages`` later: linear between stages, the last one repeated."""
        N = self.stages
        at = np.clip(np.arange(N) + stages, 0, N - 1)
        low = at.astype(int)
        part = (at - low)[:, None]
        out = y.copy()
        equalities = N * STATES + 2
        for first, width in ((0, STATES), (equalities, 2), (equalities + 2 * N, 2)):
            rows = y[first : first + N * width].reshape(N, width)
            moved = (1.0 - part) * rows[low] + part * rows[np.minimum(low + 1, N - 1)]
            out[first : first + N * width] = moved.ravel()
        return out


def build_qp(
    vehicle: Vehicle, X: Array, U: Array, current: Array, reference: Array, weights: Weights | None = None
) -> QP:
    """The QP of one cycle, linearised along a trajectory.

    ``X`` (N+1, 8) states n, e, u, v, psi, r and delivered port and starboard thrust; ``U`` (N+1, 2) their commands;
    ``current`` (N+1, 2) north and east (m/s), all at knots 0.3 s apart; ``reference`` (N, 2) north and east (m) wanted
    at the knots 1 .. N. Its unknowns are scaled deviations from X and U in the order of the stages: this file's head.
    """
    stage_s = STAGE_NS * 1e-9
    lin = linearise(X, U, current, stage_s, vehicle.coefficients())
    return SparseForm(len(U) - 1, ThrustLimits.of(vehicle, stage_s), weights or Weights()).build(lin, reference)
