"""Export of the controller's QP as C code that OSQP generates, without allocation or libraries.

The folder contains OSQP's sources and a workspace with the problem of one cycle, in which the vehicle is somewhat off
its plan. Every cycle has the same pattern, so a C program can replace the numbers with osqp_update_data_mat and
osqp_update_data_vec; mpc_layout.h describes the place of each number. The sample, emosqp.c, solves the problem and
prints the first free thrusts.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import osqp
from scipy.sparse import csc_matrix, triu

from ltv_mpc.control.config import STAGE_NS, ControllerConfig, ResolvedConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.qp.sparse import STAGE_VARIABLES
from ltv_mpc.control.solvers import Solver, make
from ltv_mpc.control.solvers.osqp import ACTIVE, EQUALITY_ROW, LIMIT_ROW, OsqpSolver
from ltv_mpc.control.solvers.recorder import RecordingSolver
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, Estimate
from ltv_mpc.references import Point
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Vehicle

PREFIX = "mpc_"

SAMPLE = """/* Solves the problem that was exported; prints status, iterations and the first free thrusts (N). */
#include <stdio.h>
#include "osqp.h"
#include "mpc_workspace.h"
#include "mpc_layout.h"

int main(void) {
  OSQPInt error = osqp_solve(&mpc_solver);
  if (error) return (int)error;
  const OSQPFloat *x = mpc_solver.solution->x;
  printf("%d %d %.17g %.17g\\n", (int)mpc_solver.info->status_val, (int)mpc_solver.info->iter,
         MPC_PORT_BEFORE + MPC_PORT_SCALE * x[MPC_FIRST_PORT],
         MPC_STARBOARD_BEFORE + MPC_STARBOARD_SCALE * x[MPC_FIRST_STARBOARD]);
  return 0;
}
"""

LAYOUT = """/* Meaning of the numbers of the QP: minimise 1/2 x'Px + q'x subject to l <= Ax <= u.

   x: for each of MPC_STAGES stages {width} numbers, deviations from the trajectory linearised along, divided by
      {scales} (n, e, u, v, psi, r, delivered port and starboard thrust, commanded port and starboard thrust);
      then the terminal velocity, north and east (m/s).
   rows: {states} of dynamics a stage and 2 of the terminal velocity, multiplied by MPC_ROW_DYNAMICS; then 2 of slew a
      stage, then 2 of box a stage, multiplied by MPC_ROW_LIMIT, where a limit is expected to be active by
      MPC_ROW_ACTIVE. */
#define MPC_STAGES {stages}
/* times of the knots after the plan's start (s), MPC_STAGES + 1 of them */
#define MPC_KNOTS_S {knots}
#define MPC_VARIABLES {variables}
#define MPC_ROWS {rows}
#define MPC_ROW_DYNAMICS {dynamics!r}
#define MPC_ROW_LIMIT {limit!r}
#define MPC_ROW_ACTIVE {active!r}
#define MPC_FIRST_PORT {port}
#define MPC_FIRST_STARBOARD {starboard}
#define MPC_PORT_SCALE {port_scale!r}
#define MPC_STARBOARD_SCALE {starboard_scale!r}
/* of the exported problem: the first free commands of the trajectory linearised along (N) */
#define MPC_PORT_BEFORE {port_before!r}
#define MPC_STARBOARD_BEFORE {starboard_before!r}
"""


class Exported(NamedTuple):
    """Size of the exported problem, and the thrusts that the sample prints within the solver's tolerance."""

    stages: int
    variables: int
    rows: int
    thrust_N: Array  # (2,)


def loaded_solver(vehicle: Vehicle, config: ControllerConfig) -> tuple[OsqpSolver, Array]:
    """Return a solver with the problem loaded, and the first free nominal commands (2,) in N.

    Raises ``ConfigError`` if the settings have another solver, or limits of the motion.
    """
    # One QP a cycle: a second one would be linearised close to its own solution.
    first = msgspec.structs.replace(config, sqp_iterations=1)
    recorded: list[RecordingSolver] = []

    def make_recorded(*settings: Any) -> Solver:
        recorded.append(RecordingSolver(make(*settings)))
        return recorded[-1]

    controller = Controller(vehicle, Point(north_m=0.0, east_m=0.0), first, make_solver=make_recorded)
    solver = recorded[0].solver
    if not isinstance(solver, OsqpSolver):
        problem = "must be osqp: OSQP generates the code"
        raise ConfigError("controller settings", "solver", problem, value=config.solver)
    if solver.form.limits.limited_states:
        raise ConfigError(
            "controller settings", "limits", "must be empty: the generated code supports thruster limits only"
        )
    controller.plan(Estimate.at_rest(north_m=0.1))
    # One cycle later and away from the first plan, so that the solution differs from the nominal trajectory.
    controller.plan(msgspec.structs.replace(Estimate.at_rest(north_m=-0.2, east_m=0.1, heading_rad=0.3), t_ns=STAGE_NS))
    return solver, recorded[0].lin.U[1]


def export(folder: Path, solver: OsqpSolver, nominal: Array, config: ResolvedConfig) -> Exported:
    """Write the code into ``folder``, over existing files; ``solver`` and ``nominal`` come from ``loaded_solver``."""
    result = solver.solve()
    qp, settings = solver.scaled_problem()
    generator = osqp.OSQP(algebra="builtin")
    P, A = csc_matrix(triu(qp.P, format="csc")), csc_matrix(qp.A)
    generator.setup(
        P, qp.q.copy(), A.copy(), qp.l.copy(), qp.u.copy(), **{**settings, "max_iter": config.max_iterations}
    )
    generator.codegen(str(folder), parameters="matrices", prefix=PREFIX, extension_name=None, force_rewrite=True)
    form = solver.form
    scale = form.limits.thrust_scale
    (folder / "mpc_layout.h").write_text(
        LAYOUT.format(
            width=STAGE_VARIABLES,
            scales=", ".join(f"{s:g}" for s in (*form.state_scale, *scale)),
            states=STATES,
            stages=form.stages,
            knots="{" + ", ".join(f"{t:.9g}" for t in config.knots * STAGE_NS * 1e-9) + "}",
            variables=form.variables,
            rows=form.rows,
            dynamics=EQUALITY_ROW,
            limit=LIMIT_ROW,
            active=LIMIT_ROW * ACTIVE,
            port=STATES,
            starboard=STATES + 1,
            port_scale=float(scale[0]),
            starboard_scale=float(scale[1]),
            port_before=float(nominal[0]),
            starboard_before=float(nominal[1]),
        ),
        encoding="utf-8",
    )
    (folder / "emosqp.c").write_text(SAMPLE, encoding="utf-8")
    return Exported(form.stages, form.variables, form.rows, result.commands[1])
