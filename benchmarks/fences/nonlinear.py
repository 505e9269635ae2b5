"""Controller whose problems are solved to convergence: CasADi and IPOPT, with the fence as soft constraints.

Cost, limits, flow, targets and first guess are the controller's own. The clearance of a zone is exact: the distance
outside, and the largest signed distance from an edge inside. As in ``fence_clearance.py`` each zone and stage has one
excess, with the same penalty, over points that are one first stage apart.
"""

from __future__ import annotations

import functools
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.peers import symbolic
from ltv_mpc.control.config import STAGE_NS
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.fallback import LateralPlan
from ltv_mpc.control.fence_clearance import PENALTY
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.lateral import LateralPlanner
from ltv_mpc.control.linearisation import roll_out
from ltv_mpc.control.prediction import Start
from ltv_mpc.geofence.zones import Zones
from ltv_mpc.messages import Array, PlanOrigin, Solve, SolveStatus
from ltv_mpc.vehicle.flow import STATES, substeps

STAGE_S = STAGE_NS * 1e-9
OPTIONS = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-6,
    "ipopt.max_iter": 300,
    "ipopt.mu_strategy": "adaptive",
}


def solve_with_ipopt(controller: Controller) -> None:
    """Let IPOPT solve the lateral problem of a controller, whose fence is set and stays."""
    lateral = controller._lateral
    lateral._solve = functools.partial(_Problem(controller, lateral).solve, lateral)  # type: ignore[method-assign]


class _Problem:
    """Nonlinear problem by direct multiple shooting: [X_k, U_k over its maximum] at the knots 1 .. N, and excesses."""

    def __init__(self, controller: Controller, lateral: LateralPlanner) -> None:
        config, vehicle = controller.config, controller.vehicle
        self._p, self._knots = vehicle.coefficients(), config.knots
        self._limits = limits = HorizonLimits.from_vehicle(vehicle, STAGE_S)
        zones, need = lateral.fencing.scene.zones, len(lateral.fencing.scene.need)
        N, w, g = config.stages, config.weights, np.diff(config.knots)
        scale = ca.DM(limits.thrust_scale)
        z, e = ca.SX.sym("z", STATES + 2, N), ca.SX.sym("e", need, N)
        X0, U0, required = ca.SX.sym("X0", STATES), ca.SX.sym("U0", 2), ca.SX.sym("required", need)
        C, target = ca.SX.sym("C", 2, N + 1), ca.SX.sym("target", 2, N + 1)
        X, U = [X0, *(z[:STATES, k] for k in range(N))], [U0, *(z[STATES:, k] for k in range(N))]
        flows = {h: symbolic.stage(h, substeps(h), self._p) for h in set((g * STAGE_S).tolist())}
        cost, gaps, changes, kept = ca.SX(0.0), [], [], []
        for k in range(N):
            flow = flows[float(g[k] * STAGE_S)]
            gaps.append(flow(X[k], scale * U[k], scale * U[k + 1], C[:, k], C[:, k + 1]) - X[k + 1])
            changes.append(U[k + 1] - U[k])
            position = w.position_per_m2 * g[k] + (w.terminal_position_per_m2 if k == N - 1 else 0.0)
            cost += position * ca.sumsqr(X[k + 1][:2] - target[:, k])
            cost += w.thrust * g[k] * ca.sumsqr(U[k + 1]) + w.thrust_change / g[k] * ca.sumsqr(changes[-1])
            cost += 2.0 * PENALTY * g[k] / limits.state_scale[0] * ca.sum1(e[:, k])
            steps = max(int(np.ceil(g[k] - 1e-6)), 1)
            for j in range(1, steps + 1):
                point = X[k][:2] + j / steps * (X[k + 1][:2] - X[k][:2])
                kept += [clearance(zones, i, point) + e[i, k] - required[i] for i in range(need)]
        off = symbolic.velocity_over_ground(X[N], C[:, N]) - target[:, N]
        cost += w.terminal_velocity_s2_per_m2 * ca.sumsqr(off)
        problem = {
            "x": ca.veccat(z, e),
            "f": cost,
            "g": ca.vertcat(*gaps, *changes, *kept),
            "p": ca.veccat(X0, U0, required, C, target),
        }
        self._solver = ca.nlpsol("solver", "ipopt", problem, OPTIONS)
        slew = np.outer(g, limits.max_change / limits.thrust_scale).ravel()
        self._low_g = np.concatenate([np.zeros(N * STATES), -slew, np.zeros(len(kept))])
        self._high_g = np.concatenate([np.zeros(N * STATES), slew, np.full(len(kept), np.inf)])

    def solve(self, lateral: LateralPlanner, start: Start) -> LateralPlan | Solve:
        """Solve from what the controller would linearise along."""
        lateral._linearise(start)
        lin, F, N = lateral._lin, self._limits.thrust_scale, len(lateral._lin.Phi)
        need = lateral.fencing.scene.need
        low, high = (bound / F for bound in self._limits.box(lin.U[0], self._knots))
        free, excess = np.full((N, STATES), np.inf), np.zeros(N * len(need))
        found = self._solver(
            x0=np.concatenate([np.hstack([lin.X[1:], lin.U[1:] / F]).ravel(), excess]),
            p=np.concatenate([lin.X[0], lin.U[0] / F, need, lin.C.ravel(), lateral.target[:, :2].ravel()]),
            lbx=np.concatenate([np.hstack([-free, low]).ravel(), excess]),
            ubx=np.concatenate([np.hstack([free, high]).ravel(), excess + np.inf]),
            lbg=self._low_g,
            ubg=self._high_g,
        )
        stats = self._solver.stats()
        commands: Array = found["x"].full().ravel()[: N * (STATES + 2)].reshape(N, -1)[:, STATES:] * F
        U = self._limits.clip(np.concatenate([lin.U[:1], commands]), self._knots)
        X = roll_out(lin.X[0], U, lin.C, np.diff(self._knots) * STAGE_S, self._p)
        status = SolveStatus.SOLVED if stats["success"] else SolveStatus.ITERATION_LIMIT
        solve = Solve(status=status, iterations=int(stats["iter_count"]), why=str(stats["return_status"])[:50])
        return LateralPlan(X, U, PlanOrigin.SOLVED, solve, "")


def clearance(zones: Zones, i: int, point: Any) -> Any:
    """Return the clearance of a point from convex keep-out zone i as an expression (m)."""
    corners = zones.vertices[zones.first[i] : zones.first[i + 1]]
    if len(corners) == 1:
        return ca.norm_2(point - ca.DM(corners[0])) - zones.radius[i]
    following = np.roll(corners, -1, axis=0)
    area = float((corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]).sum())
    squares, signed = [], []
    for a, b in zip(corners, following, strict=True):
        edge, length = b - a, float(np.hypot(*(b - a)))
        outward = np.array([edge[1], -edge[0]]) * np.sign(area) / length
        along = ca.fmin(ca.fmax(ca.dot(point - ca.DM(a), ca.DM(edge / length**2)), 0.0), 1.0)
        squares.append(ca.sumsqr(point - ca.DM(a) - along * ca.DM(edge)))
        signed.append(ca.dot(ca.DM(outward), point - ca.DM(a)))
    inside = functools.reduce(ca.fmax, signed)
    outside = ca.sqrt(ca.fmax(functools.reduce(ca.fmin, squares), 1e-12))
    return ca.if_else(inside > 0.0, outside, inside)
