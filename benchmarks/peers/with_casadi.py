"""CasADi and IPOPT on the nonlinear problem: direct multiple shooting, exact derivatives, warm started.

The flow over a stage is one step of Runge-Kutta 4, with thruster lag in closed form and commands linear in time as the
controller has them. IPOPT starts from primal and dual of the last solution, moved along; of the ways to choose its
barrier parameter the adaptive one took the fewest iterations then.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from benchmarks.peers import symbolic
from benchmarks.peers.peer import Peer
from ltv_mpc.control.config import STAGE_NS, ResolvedConfig
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Vehicle

OPTIONS = {
    "expand": True,
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.warm_start_init_point": "yes",
    "ipopt.warm_start_bound_push": 1e-6,
    "ipopt.warm_start_mult_bound_push": 1e-6,
    "ipopt.warm_start_slack_bound_push": 1e-6,
    "ipopt.mu_strategy": "adaptive",
}


class CasadiIpopt(Peer):
    """Unknowns: [X_k, U_k] at the knots 1 .. N, the thrusts over their maxima."""

    name = "CasADi + IPOPT"
    solves = "NLP"
    settings = "multiple shooting, MUMPS, expand, warm_start_init_point with 1e-6 pushes, mu_strategy adaptive"

    def __init__(self, config: ResolvedConfig, limits: Constants, vehicle: Vehicle) -> None:
        super().__init__(config, limits, vehicle)
        N, w, h = self.stages, self.weights, STAGE_NS * 1e-9
        flow = symbolic.stage(h, 1, vehicle.coefficients())
        scale = ca.DM(limits.thrust_scale)
        z = ca.SX.sym("z", STATES + 2, N)
        X0, U0 = ca.SX.sym("X0", STATES), ca.SX.sym("U0", 2)
        C, reference = ca.SX.sym("C", 2, N + 1), ca.SX.sym("reference", 2, N)
        X, U = [X0, *(z[:STATES, k] for k in range(N))], [U0, *(z[STATES:, k] for k in range(N))]
        cost, gaps, changes = ca.SX(0.0), [], []
        for k in range(N):
            to_N = scale * U[k], scale * U[k + 1]
            gaps.append(flow(X[k], *to_N, C[:, k], C[:, k + 1]) - X[k + 1])
            changes.append(U[k + 1] - U[k])
            cost += w.position_per_m2 * ca.sumsqr(X[k + 1][:2] - reference[:, k])
            cost += w.thrust * ca.sumsqr(U[k + 1]) + w.thrust_change * ca.sumsqr(changes[-1])
        cost += w.terminal_position_per_m2 * ca.sumsqr(X[N][:2] - reference[:, N - 1])
        cost += w.terminal_velocity_s2_per_m2 * ca.sumsqr(symbolic.velocity_over_ground(X[N], C[:, N]))
        problem = {
            "x": ca.vec(z),
            "f": cost,
            "g": ca.vertcat(*gaps, *changes),
            "p": ca.vertcat(X0, U0, ca.vec(C), ca.vec(reference)),
        }
        self._solver = ca.nlpsol("solver", "ipopt", problem, OPTIONS)
        self._slew = np.tile(limits.max_change / limits.thrust_scale, N)
        self._duals: dict[str, Array] = {}

    def reset_warm_start(self) -> None:
        """Discard the duals, which do not help with another problem."""
        self._duals = {}

    def shift_warm_start(self, stages: float) -> None:
        """Shift to the nearest whole stage and repeat the last one."""
        by = np.minimum(np.arange(self.stages) + round(stages), self.stages - 1)
        gaps = self.stages * STATES
        for name, dual in self._duals.items():
            blocks = (dual[:gaps], dual[gaps:]) if name == "lam_g0" else (dual,)
            self._duals[name] = np.concatenate([block.reshape(self.stages, -1)[by].ravel() for block in blocks])

    def find(self) -> Result:
        """Solve from the guess and the duals of the last solution."""
        lin, F, N = self.lin, self.limits.thrust_scale, self.stages
        low, high = (bound / F for bound in self.box())
        free = np.full((N, STATES), np.inf)
        found = self._solver(
            x0=np.hstack([lin.X[1:], lin.U[1:] / F]).ravel(),
            p=np.concatenate([lin.X[0], lin.U[0] / F, lin.C.ravel(), np.ravel(self.reference)]),
            lbx=np.hstack([-free, low]).ravel(),
            ubx=np.hstack([free, high]).ravel(),
            lbg=np.concatenate([np.zeros(N * STATES), -self._slew]),
            ubg=np.concatenate([np.zeros(N * STATES), self._slew]),
            **self._duals,
        )
        stats = self._solver.stats()
        iterations = int(stats["iter_count"])
        if not stats["success"]:
            self.reset_warm_start()
            return self.answer(None, iterations=iterations, why=str(stats["return_status"]))
        self._duals = {"lam_x0": found["lam_x"].full().ravel(), "lam_g0": found["lam_g"].full().ravel()}
        return self.answer(found["x"].full().reshape(N, -1)[:, STATES:] * F, iterations=iterations)
