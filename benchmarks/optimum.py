"""Converged optimum of the nonlinear problem of a descent: CasADi and IPOPT, as a rival of the QPs (closed_loop.py)."""

from __future__ import annotations

import casadi as ca
import numpy as np

from benchmarks.peers import symbolic
from ltv_mpc.control.config import STAGE_NS, ResolvedConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import roll_out
from ltv_mpc.control.ocp.assembly import cost
from ltv_mpc.control.problem_data import pack_objective, unpack_objective
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES, substeps
from ltv_mpc.vehicle.parameters import Vehicle

STAGE_S = STAGE_NS * 1e-9


class Optimum:
    """Nonlinear problem of N stages, by multiple shooting and IPOPT."""

    def __init__(self, vehicle: Vehicle, config: ResolvedConfig) -> None:
        self._p, self._weights = vehicle.coefficients(), config.weights
        self.limits = HorizonLimits.from_vehicle(vehicle, STAGE_S)
        self._packed = pack_objective(config.knots, self.limits, self._weights)
        self._N = N = config.stages
        self._knots, self._g = config.knots, np.diff(config.knots)
        self._h = self._g * STAGE_S
        X, U = ca.SX.sym("X", STATES, N), ca.SX.sym("U", 2, N)
        X0, U0 = ca.SX.sym("X0", STATES), ca.SX.sym("U0", 2)
        C, target = ca.SX.sym("C", 2, N + 1), ca.SX.sym("target", 2, N + 1)
        stage = {h: symbolic.stage(h, substeps(h), self._p) for h in set(self._h.tolist())}
        xs, us = [X0, *ca.horzsplit(X)], [U0, *ca.horzsplit(U)]
        gaps = [stage[self._h[k]](xs[k], us[k], us[k + 1], C[:, k], C[:, k + 1]) - xs[k + 1] for k in range(N)]
        steps = [us[k + 1] - us[k] for k in range(N)]
        w, scale = self._weights, ca.DM(self.limits.thrust_scale)
        objective = 0
        for k in range(N):
            g = self._g[k]
            position = w.position_per_m2 * g + (w.terminal_position_per_m2 if k == N - 1 else 0.0)
            objective += position * ca.sumsqr(xs[k + 1][:2] - target[:, k])
            objective += w.thrust * g * ca.sumsqr(us[k + 1] / scale)
            objective += w.thrust_change / g * ca.sumsqr(steps[k] / scale)
        off = symbolic.velocity_over_ground(xs[N], C[:, N]) - target[:, N]
        objective += w.terminal_velocity_s2_per_m2 * ca.sumsqr(off)
        problem = {
            "x": ca.veccat(X, U),
            "p": ca.veccat(X0, U0, C, target),
            "f": 0.5 * objective,
            "g": ca.veccat(*gaps, *steps),
        }
        options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-9, "max_iter": 500}}
        self._solve = ca.nlpsol("optimum", "ipopt", problem, options)

    def cost(self, X0: Array, U: Array, C: Array, target: Array) -> float:
        """Return the cost of commands U (N+1, 2) along the exact flow."""
        wanted = np.column_stack([target, np.zeros(len(target))])  # no heading
        return cost(self.roll(X0, U, C), U, C, wanted, unpack_objective(self._packed))

    def roll(self, X0: Array, U: Array, C: Array) -> Array:
        """Compute the exact flow (N+1, 8) under commands U (N+1, 2)."""
        return roll_out(X0, U, C, self._h, self._p)

    def solve(self, X: Array, U: Array, C: Array, target: Array) -> tuple[Array, bool]:
        """Return commands (N+1, 2) from a guess X (N+1, 8), U (N+1, 2), and whether IPOPT converged."""
        N, limits = self._N, self.limits
        low, high = limits.box(U[0], self._knots)
        free, change = np.full(N * STATES, np.inf), np.outer(self._g, limits.max_change).ravel()
        answer = self._solve(
            x0=np.concatenate([X[1:].ravel(), U[1:].ravel()]),
            p=np.concatenate([X[0], U[0], C.ravel(), target.ravel()]),
            lbx=np.concatenate([-free, low.ravel()]),
            ubx=np.concatenate([free, high.ravel()]),
            lbg=np.concatenate([np.zeros(N * STATES), -change]),
            ubg=np.concatenate([np.zeros(N * STATES), change]),
        )
        commands = np.array(answer["x"]).ravel()[N * STATES :].reshape(N, 2)
        enforced: Array = limits.clip(np.concatenate([U[:1], commands]), self._knots)
        return enforced, bool(self._solve.stats()["success"])
