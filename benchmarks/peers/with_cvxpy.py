"""cvxpy, compiled once and solved with new parameters in each cycle, by OSQP.

As its pages on disciplined parametrised programming and on performance say: vectorised, every number that changes is a
parameter that enters affinely, quadratic terms are ``sum_squares``, warm start on. The dynamics of all stages are one
matrix of known sparsity.
"""

from __future__ import annotations

import warnings

import cvxpy as cp
import numpy as np
from scipy.sparse import coo_array

from benchmarks.peers.peer import Peer
from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.linearisation import velocity_over_ground
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Vehicle


class CvxpyOsqp(Peer):
    """Unknowns: deviations of states and commands in units of their scales, stages after each other, and p'_N."""

    name = "cvxpy + OSQP"
    solves = "QP"
    settings = "DPP, one sparse parameter for the dynamics, warm_start=True; OSQP as cvxpy sets it"

    def __init__(self, config: ResolvedConfig, limits: Constants, vehicle: Vehicle) -> None:
        super().__init__(config, limits, vehicle)
        N, w = self.stages, self.weights
        self._scale = np.concatenate([limits.state_scale, limits.thrust_scale])
        self._rows, self._columns = _dynamics_pattern(N)
        z, du, velocity = cp.Variable(STATES * N), cp.Variable(2 * N), cp.Variable(2)
        self._du = du
        self._dynamics = cp.Parameter((STATES * N, (STATES + 2) * N), sparsity=(self._rows, self._columns))
        self._gap = cp.Parameter(STATES * N)
        self._plan, self._first = cp.Parameter((N, 2)), cp.Parameter((1, 2))
        self._low, self._high = cp.Parameter((N, 2)), cp.Parameter((N, 2))
        self._wanted, self._slope, self._velocity = cp.Parameter((N, 2)), cp.Parameter((2, 3)), cp.Parameter(2)
        states = cp.reshape(z, (N, STATES), order="C")
        off = states[:, :2] - self._wanted
        u = self._plan + cp.reshape(du, (N, 2), order="C")
        change = u - cp.vstack([self._first, u[:-1]])
        cost = (
            w.position_per_m2 * cp.sum_squares(off)
            + w.terminal_position_per_m2 * cp.sum_squares(off[-1])
            + w.terminal_velocity_s2_per_m2 * cp.sum_squares(velocity)
            + w.thrust * cp.sum_squares(u)
            + w.thrust_change * cp.sum_squares(change)
        )
        slew = limits.max_change / limits.thrust_scale
        self._problem = cp.Problem(
            cp.Minimize(cost),
            [
                self._dynamics @ cp.hstack([z, du]) == self._gap,
                velocity == self._velocity + self._slope @ states[-1, 2:5],
                u >= self._low,
                u <= self._high,
                change <= slew[None, :],
                change >= -slew[None, :],
            ],
        )

    def find(self) -> Result:
        """Set the parameters and solve."""
        lin, F, N = self.lin, self.limits.thrust_scale, self.stages
        low, high = self.box()
        velocity, slope = velocity_over_ground(lin.X[-1], lin.C[-1])
        values = (self._dynamics_values(), (self._rows, self._columns))
        self._dynamics.value_sparse = coo_array(values, shape=self._dynamics.shape)
        self._gap.value = ((lin.Phi - lin.X[1:]) / self._scale).ravel()
        self._plan.value, self._first.value = lin.U[1:] / F, lin.U[:1] / F
        self._low.value, self._high.value = low / F, high / F
        self._wanted.value = self.reference - lin.X[1:, :2]
        self._slope.value, self._velocity.value = slope * self._scale[2:5], velocity
        try:
            with warnings.catch_warnings():  # that cvxpy itself reads the sparse parameter's dense value
                warnings.simplefilter("ignore", RuntimeWarning)
                self._problem.solve(solver=cp.OSQP, warm_start=True)
        except cp.SolverError as error:
            return self.answer(None, why=str(error))
        found = None if self._du.value is None else lin.U[1:] + self._du.value.reshape(N, 2) * F
        return self.answer(found, iterations=self._problem.solver_stats.num_iters or 0, why=self._problem.status)

    def _dynamics_values(self) -> Array:
        """Return I, -A, -B0, -B1 in the order of the pattern."""
        lin, scale, F = self.lin, self._scale, self.limits.thrust_scale
        A = lin.A[1:] * (scale[None, :] / scale[:, None])
        B0, B1 = lin.B0[1:] * (F / scale[:, None]), lin.B1 * (F / scale[:, None])
        return np.concatenate([np.ones(len(scale) * self.stages), -A.ravel(), -B0.ravel(), -B1.ravel()])


def _dynamics_pattern(N: int) -> tuple[Array, Array]:
    """Return rows and columns of z_(k+1) - A_k z_k - B0_k du_k - B1_k du_(k+1), with z_0 and du_0 equal to 0."""
    k = np.arange(N)

    def blocks(stages: Array, first: int, width: int, behind: int) -> tuple[Array, Array]:
        rows = stages[:, None, None] * STATES + np.arange(STATES)[None, :, None] + np.zeros((1, 1, width), dtype=int)
        columns = first + (stages[:, None, None] - behind) * width + np.arange(width)[None, None, :]
        return rows.ravel(), (columns + np.zeros((1, STATES, 1), dtype=int)).ravel()

    parts = [
        (np.arange(STATES * N), np.arange(STATES * N)),
        blocks(k[1:], 0, STATES, 1),
        blocks(k[1:], STATES * N, 2, 1),
        blocks(k, STATES * N, 2, 0),
    ]
    rows, columns = (np.concatenate(part) for part in zip(*parts, strict=True))
    return rows, columns
