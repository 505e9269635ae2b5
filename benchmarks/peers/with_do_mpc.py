"""do-mpc: a continuous model, orthogonal collocation and IPOPT, as its "getting started: MPC" sets one up.

States are those of the controller and the two commands, whose rates are the inputs: so commands are linear between the
knots. Currents are time-varying parameters, which do-mpc holds over a stage: their means. do-mpc starts each solve from
its last solution by itself.
"""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca
import numpy as np

with warnings.catch_warnings():  # that parts of do-mpc which are not used here want further packages
    warnings.simplefilter("ignore", UserWarning)
    import do_mpc

from benchmarks.peers import symbolic
from benchmarks.peers.peer import Peer
from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.problem_data import STAGE_S, Constants
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.vehicle.parameters import Vehicle

ca.GlobalOptions.setNumpyMode(-1)  # do-mpc relies on what numpy's functions did with CasADi's values before 3.8


class DoMpcIpopt(Peer):
    """Commands and their rates over the thrusters' maxima."""

    name = "do-mpc + IPOPT"
    solves = "NLP"
    settings = "collocation (Radau, degree 2, one element), MUMPS: its defaults; nothing stored"

    def __init__(self, config: ResolvedConfig, limits: Constants, vehicle: Vehicle) -> None:
        super().__init__(config, limits, vehicle)
        model = self._model()
        self._mpc = mpc = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon = self.stages
        mpc.settings.t_step = STAGE_S
        mpc.settings.use_terminal_bounds = True
        mpc.settings.store_lagr_multiplier = False
        mpc.settings.store_solver_stats = []
        mpc.settings.supress_ipopt_output()
        self._set_objective(model)
        slew = limits.max_change / limits.thrust_scale / STAGE_S
        mpc.bounds["lower", "_u", "rate"], mpc.bounds["upper", "_u", "rate"] = -slew, slew
        for side, bound in (("lower", limits.low), ("upper", limits.high)):
            mpc.bounds[side, "_x", "U"] = bound / limits.thrust_scale
            mpc.terminal_bounds[side, "U"] = bound / limits.thrust_scale  # else the last knot has none
        self._parameters = mpc.get_tvp_template()
        mpc.set_tvp_fun(lambda _t: self._parameters)
        mpc.setup()
        self._begun = False

    def reset_warm_start(self) -> None:
        """Reset the initial guess: the last solution does not suit the next problem."""
        self._begun = False

    def find(self) -> Result:
        """One ``make_step``."""
        lin, F, N, mpc = self.lin, self.limits.thrust_scale, self.stages, self._mpc
        middle, slope = (lin.C[:-1] + lin.C[1:]) / 2, np.diff(lin.C, axis=0) / STAGE_S
        for k in range(N + 1):
            self._parameters["_tvp", k, "c"] = middle[k] if k < N else lin.C[N]
            self._parameters["_tvp", k, "cr"] = slope[min(k, N - 1)]
            self._parameters["_tvp", k, "reference"] = self.reference[max(k - 1, 0)]
        x0 = np.concatenate([lin.X[0], lin.U[0] / F])
        if not self._begun:
            mpc.x0 = x0
            mpc.set_initial_guess()
            self._begun = True
        mpc.make_step(x0[:, None])
        iterations = int(mpc.solver_stats["iter_count"])
        if not mpc.solver_stats["success"]:
            self.reset_warm_start()
            return self.answer(None, iterations=iterations, why=str(mpc.solver_stats["return_status"]))
        at_end = [mpc.opt_x_num["_x", k + 1, 0, -1].full().ravel()[8:10] for k in range(N)]
        return self.answer(np.array(at_end) * F, iterations=iterations)

    def _model(self) -> Any:
        p, F = self.vehicle.coefficients(), ca.DM(self.limits.thrust_scale)
        model = do_mpc.model.Model("continuous", "SX")
        x = model.set_variable("_x", "x", (6, 1))
        thrust = model.set_variable("_x", "F", (2, 1))
        U = model.set_variable("_x", "U", (2, 1))
        rate = model.set_variable("_u", "rate", (2, 1))
        c = model.set_variable("_tvp", "c", (2, 1))
        cr = model.set_variable("_tvp", "cr", (2, 1))
        model.set_variable("_tvp", "reference", (2, 1))
        lag = ca.DM([p.lag_port, p.lag_starboard])
        model.set_rhs("x", symbolic.rates(x, thrust, c, cr, p))
        model.set_rhs("F", (F * U - thrust) / lag)
        model.set_rhs("U", rate)
        model.setup()
        return model

    def _set_objective(self, model: Any) -> None:
        """Set the objective: thrusts and positions at knots 1 .. N-1 are stage costs, those at N the terminal cost."""
        w, x, U = self.weights, model.x["x"], model.x["U"]
        off = ca.sumsqr(x[:2] - model.tvp["reference"])
        velocity = ca.sumsqr(symbolic.velocity_over_ground(x, model.tvp["c"]))
        thrust = w.thrust * ca.sumsqr(U)
        self._mpc.set_objective(
            lterm=w.position_per_m2 * off + thrust + w.thrust_change * ca.sumsqr(STAGE_S * model.u["rate"]),
            mterm=(w.position_per_m2 + w.terminal_position_per_m2) * off
            + w.terminal_velocity_s2_per_m2 * velocity
            + thrust,
        )
        self._mpc.set_rterm(rate=0.0)
