"""qpmpc with DAQP: a linear time-varying problem, condensed by qpmpc in each cycle and solved through qpsolvers.

qpmpc takes one weight for all of a state and x_(k+1) = A_k x_k + B_k u_k without a constant. So the cost is put into
the states' coordinates, a thrust's change is the input, and a state that is always 1 carries constants:

    z_k = [S (X_k - Xbar_k), sqrt(r) U_k / F, eps],   u_k = sqrt(s) (U_(k+1) - U_k) / F

S holds the square roots of weights, eps where there is none. After the last stage u and v make way for the velocity
over ground, which only the terminal cost knows.
"""

from __future__ import annotations

import numpy as np
from qpmpc import MPCProblem, solve_mpc

from benchmarks.peers.peer import Peer
from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.linearisation import velocity_over_ground
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Vehicle

SMALL = 1e-5
"""eps: its square stands for no weight."""

WIDTH = STATES + 3


class QpmpcDaqp(Peer):
    """A problem object a cycle, as its examples for time-varying systems do."""

    name = "qpmpc + DAQP"
    solves = "QP"
    settings = "dense, defaults"

    def __init__(self, config: ResolvedConfig, limits: Constants, vehicle: Vehicle) -> None:
        super().__init__(config, limits, vehicle)
        w, F = self.weights, limits.thrust_scale
        position, thrust = np.sqrt(w.position_per_m2), max(np.sqrt(w.thrust), SMALL) / F
        self._stage = np.diag([position, position, *[SMALL] * 6, *thrust, SMALL])
        last = np.sqrt(w.position_per_m2 + w.terminal_position_per_m2)
        self._end = np.diag([last, last, *[SMALL] * 6, *thrust, SMALL])
        self._change = F / max(np.sqrt(w.thrust_change), SMALL)  # u -> N
        self._box = np.zeros((8, WIDTH))
        # rows: U + change <= high, -(U + change) <= -low, change and -change <= slew
        self._box[0:2, STATES : STATES + 2] = np.diag(1.0 / thrust)
        self._box[2:4] = -self._box[0:2]
        change = np.diag(self._change)
        self._of_change = np.vstack([change, -change, change, -change])

    def find(self) -> Result:
        """Set up and solve."""
        lin, N = self.lin, self.stages
        A, B = self._transitions()
        low, high = self.box()
        slew = self.limits.max_change
        # the reference in coordinates of the stage; U = 0 and the constant are their own targets
        at = np.zeros((N + 1, WIDTH))
        at[1:, :2] = self.reference - lin.X[1:, :2]
        at[:, -1] = 1.0
        goal = self._terminal_coordinates() @ at[N]
        goal[2:4] = 0.0  # no velocity over ground
        problem = MPCProblem(
            transition_state_matrix=A,
            transition_input_matrix=B,
            ineq_state_matrix=self._box,
            ineq_input_matrix=self._of_change,
            ineq_vector=[np.concatenate([high[k], -low[k], slew, slew]) for k in range(N)],
            nb_timesteps=N,
            terminal_cost_weight=1.0,
            stage_state_cost_weight=1.0,
            stage_input_cost_weight=1.0,
            initial_state=self._stage @ np.concatenate([np.zeros(STATES), lin.U[0], [1.0]]),
            goal_state=goal,
            target_states=(at[:N] @ self._stage).ravel(),
        )
        plan = solve_mpc(problem, solver="daqp")
        if plan.is_empty:
            return self.answer(None, why="no solution found")
        return self.answer(lin.U[0] + np.cumsum(plan.inputs * self._change, axis=0))

    def _transitions(self) -> tuple[list[Array], list[Array]]:
        """A_k (11, 11) and B_k (11, 2) of z."""
        lin, N = self.lin, self.stages
        A, B = np.zeros((N, WIDTH, WIDTH)), np.zeros((N, WIDTH, 2))
        both = lin.B0 + lin.B1
        gap = lin.Phi - lin.X[1:]
        # d_(k+1) = A d_k + B0 (U_k - Ubar_k) + B1 (U_k + change - Ubar_(k+1)) + gap
        A[:, :STATES, :STATES] = lin.A
        A[:, :STATES, STATES : STATES + 2] = both
        A[:, :STATES, -1] = gap - (lin.B0 @ lin.U[:-1, :, None] + lin.B1 @ lin.U[1:, :, None])[..., 0]
        A[:, STATES : STATES + 2, STATES : STATES + 2] = np.eye(2)
        A[:, -1, -1] = 1.0
        B[:, :STATES] = lin.B1 * self._change
        B[:, STATES : STATES + 2] = np.diag(self._change)
        back = np.diag(1.0 / np.diag(self._stage))
        A, B = self._stage @ A @ back, self._stage @ B
        to_end = self._terminal_coordinates() @ back
        A[-1], B[-1] = to_end @ A[-1], to_end @ B[-1]
        return list(A), list(B)

    def _terminal_coordinates(self) -> Array:
        """Return the map from [X_N - Xbar_N, U_N, 1] to coordinates whose sum of squares is the terminal cost."""
        T = self._end.copy()
        velocity, slope = velocity_over_ground(self.lin.X[-1], self.lin.C[-1])
        weight = np.sqrt(self.weights.terminal_velocity_s2_per_m2)
        T[2:4] = 0.0
        T[2:4, 2:5] = weight * slope
        T[2:4, -1] = weight * velocity
        return T
