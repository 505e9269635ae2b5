"""acados: real-time iterations (SQP_RTI) with HPIPM, as its own examples of nonlinear MPC set one up; solver in C.

Its state is the controller's with the two commands, its input their change over a stage; the flow over a stage is that
of the controller, given as discrete dynamics with the coefficients that the controller has learned. One iteration from
the controller's guess is then one QP, the controller's own. docs/notes/peers.md says how to install it.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import acados
import casadi as ca
import numpy as np

os.environ.setdefault("ACADOS_SOURCE_DIR", acados.DIR)
os.environ.setdefault("ACADOS_PYTHON_INTERFACE_PATH", acados.TEMPLATE_DIR)
for library in ("libblasfeo.so", "libhpipm.so", "libqpOASES_e.so.3.1"):  # those of libacados.so, which cannot find them
    ctypes.CDLL(f"{acados.LIB_DIR}/{library}")
from acados.acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver  # noqa: E402

from benchmarks.peers import symbolic  # noqa: E402
from benchmarks.peers.peer import Peer  # noqa: E402
from ltv_mpc.control.config import ResolvedConfig, Weights  # noqa: E402
from ltv_mpc.control.problem_data import STAGE_S, Constants  # noqa: E402
from ltv_mpc.control.solvers.interface import Result  # noqa: E402
from ltv_mpc.messages import Array  # noqa: E402
from ltv_mpc.vehicle.flow import STATES, substeps  # noqa: E402
from ltv_mpc.vehicle.parameters import Vehicle  # noqa: E402

COMMANDS = slice(STATES, STATES + 2)


class AcadosRti(Peer):
    """Unknowns: [X_k, U_k] at the knots and the change of U over each stage, thrusts over their maxima."""

    name = "acados (SQP_RTI, HPIPM)"
    solves = "QP"
    settings = "PARTIAL_CONDENSING_HPIPM, defaults; data set through its Python interface"

    def __init__(self, config: ResolvedConfig, limits: Constants, vehicle: Vehicle) -> None:
        super().__init__(config, limits, vehicle)
        self._solver = _solver(self.stages, self.weights, vehicle, tuple(limits.thrust_scale))
        self._set_bounds()

    def _set_bounds(self) -> None:
        slew = self.limits.max_change / self.limits.thrust_scale
        for k in range(self.stages):
            self._solver.set(k, "lbu", -slew)
            self._solver.set(k, "ubu", slew)

    def find(self) -> Result:
        """Set the data of the cycle, and take one iteration from the controller's guess."""
        lin, F, N, solver = self.lin, self.limits.thrust_scale, self.stages, self._solver
        X, changes = np.hstack([lin.X, lin.U / F]), np.diff(lin.U / F, axis=0)
        currents = np.hstack([lin.C, np.vstack([lin.C[1:], lin.C[-1:]])])
        parameters = np.hstack([currents, np.tile(self.coefficients, (N + 1, 1))])
        low, high = (bound / F for bound in self.box())
        wanted = np.zeros((N + 1, 6))
        wanted[1:, :2] = self.reference
        for k in range(N + 1):
            solver.set(k, "p", parameters[k])
            solver.set(k, "x", X[k])
            if k < N:
                solver.set(k, "u", changes[k])
            if k == 0:
                solver.set(0, "lbx", X[0])
                solver.set(0, "ubx", X[0])
            else:
                solver.set(k, "yref", wanted[k])
                solver.set(k, "lbx", low[k - 1])
                solver.set(k, "ubx", high[k - 1])
        if status := solver.solve():
            solver.reset()
            self._set_bounds()
            return self.answer(None, why=f"status {status}")
        return self.answer(np.array([solver.get(k, "x")[COMMANDS] for k in range(1, N + 1)]) * F, iterations=1)


@cache
def _solver(stages: int, weights: Weights, vehicle: Vehicle, thrust_scale: tuple[float, float]) -> AcadosOcpSolver:
    """Generate and compile a solver; another controller with the same problem uses it again."""
    ocp = AcadosOcp()
    ocp.dims.N = stages
    _set_model(ocp, vehicle, np.array(thrust_scale))
    _set_cost(ocp, weights)
    ocp.constraints.x0 = np.zeros(STATES + 2)
    for end in ("", "_e"):
        setattr(ocp.constraints, f"idxbx{end}", np.arange(STATES, STATES + 2))
        setattr(ocp.constraints, f"lbx{end}", -np.ones(2))
        setattr(ocp.constraints, f"ubx{end}", np.ones(2))
    ocp.constraints.idxbu, ocp.constraints.lbu, ocp.constraints.ubu = np.arange(2), -np.ones(2), np.ones(2)
    options = ocp.solver_options
    options.tf = stages  # time steps of 1: stage costs are multiplied by them
    options.integrator_type = "DISCRETE"
    options.hessian_approx = "GAUSS_NEWTON"
    options.nlp_solver_type = "SQP_RTI"
    options.qp_solver = "PARTIAL_CONDENSING_HPIPM"
    folder = Path(tempfile.mkdtemp(prefix="acados-"))
    ocp.code_export_directory = str(folder / "code")
    with contextlib.redirect_stdout(io.StringIO()):
        return AcadosOcpSolver(ocp, json_file=str(folder / "ocp.json"), verbose=False)


def _set_model(ocp: AcadosOcp, vehicle: Vehicle, thrust_scale: Array) -> None:
    x, change, currents = (ca.SX.sym(*of) for of in (("x", STATES + 2), ("change", 2), ("currents", 4)))
    p = vehicle.coefficients()
    learned = ca.SX.sym("coefficients", len(p))
    lags = {name: value for name, value in p._asdict().items() if name.startswith("lag_")}  # never learned
    p = type(p)(*ca.vertsplit(learned))._replace(**lags)
    U, scale = x[COMMANDS], ca.DM(thrust_scale)
    stage = x[:STATES], scale * U, scale * (U + change), currents[:2], currents[2:]
    X = symbolic.flow(*stage, STAGE_S, substeps(STAGE_S), p)
    model = AcadosModel()
    model.name = "vehicle"
    model.x, model.u, model.p = x, change, ca.vertcat(currents, learned)
    model.disc_dyn_expr = ca.vertcat(X, U + change)
    model.cost_y_expr_0 = change
    model.cost_y_expr = ca.vertcat(x[:2], U, change)
    model.cost_y_expr_e = ca.vertcat(x[:2], U, symbolic.velocity_over_ground(x, currents[:2]))
    ocp.model = model
    ocp.parameter_values = np.zeros(4 + len(p))


def _set_cost(ocp: AcadosOcp, w: Weights) -> None:
    """Positions and thrusts count at the knots 1 .. N, changes over each stage, the velocity at the end."""
    weights: dict[str, list[Any]] = {
        "_0": [w.thrust_change],
        "": [w.position_per_m2, w.thrust, w.thrust_change],
        "_e": [w.position_per_m2 + w.terminal_position_per_m2, w.thrust, w.terminal_velocity_s2_per_m2],
    }
    for place, values in weights.items():
        diagonal = np.repeat(values, 2)
        setattr(ocp.cost, f"cost_type{place}", "NONLINEAR_LS")
        setattr(ocp.cost, f"W{place}", np.diag(diagonal))
        setattr(ocp.cost, f"yref{place}", np.zeros(len(diagonal)))
