"""Export of the controller's QP as C code that OSQP generates, without allocation or libraries.

The problem is that of one cycle, with its rows scaled as the controller scales them (solvers/osqp.py). The exported
solve begins at x = 0. ``mpc_layout.h`` names every column and row, so that a program can set the numbers of its own
cycles, and has the controller's solution.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt
import osqp
from scipy.sparse import csc_matrix

from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.failed_qp import STATES, row_names
from ltv_mpc.control.ocp.assembly import scales
from ltv_mpc.control.problem_data import CHANGES, COMMANDS
from ltv_mpc.control.solvers import make, riccati
from ltv_mpc.control.solvers.osqp import SETTINGS, Arrays, prepare
from ltv_mpc.control.solvers.recorder import RecordingSolver
from ltv_mpc.control.solvers.sparse import EXCESS, SparseLayout
from ltv_mpc.control.solvers.sweep import Sweep
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Estimate, SolveStatus
from ltv_mpc.references import Point
from ltv_mpc.vehicle.parameters import Vehicle

HEAD = """/* QP of mpc_workspace.c: minimise 1/2 x'Px + q'x subject to l <= Ax <= u.
   x is the deviation from the trajectory that the problem is linearised along; x[j] * mpc_column_scale[j] has the unit
   of its comment. Rows of A, l and u are the controller's, times mpc_row_factor[i]; without this factor a row times
   mpc_row_scale[i] has the unit of its comment. mpc_commands has the columns of port and starboard in x.
   Numbers of another cycle: osqp_update_data_mat (stored entries of A, and of P's upper triangle, by column),
   osqp_update_data_vec, osqp_solve. */
"""


class Exported(NamedTuple):
    """Size of the exported problem."""

    stages: int
    variables: int
    rows: int


def solved_cycle(vehicle: Vehicle, config: ResolvedConfig) -> RecordingSolver:
    """Return a solver with the problem of one cycle and its solution.

    The vehicle is off its point and abeam of it, so that limits are active and the solution is not zero. Raises
    ``ConfigError`` if the solver of the settings does not solve the problem.
    """
    once = msgspec.structs.replace(config, sqp_iterations=1)
    cycle, here = RecordingSolver(make(vehicle, once)), Point(north_m=0.0, east_m=0.0)
    controller = Controller(vehicle, here, once, make_solver=lambda _vehicle, _config: cycle)
    plan = controller.plan(Estimate.at_rest(north_m=-3.0, east_m=2.0, heading_rad=1.0))
    if plan.solve.status is not SolveStatus.SOLVED:
        raise ConfigError("controller settings", "", f"the QP to export is not solved: {plan.solve.why}")
    return cycle


def export(folder: Path, cycle: RecordingSolver, vehicle: Vehicle, config: ResolvedConfig) -> Exported:
    """Write the code of a solved cycle into ``folder``, over existing files."""
    problem, z = cycle.problem, cycle.result.z
    layout = SparseLayout(problem)
    N, n, m, at = len(problem.f), layout.variables, layout.rows, Arrays.empty(layout)
    work, duals, numbers = Sweep.empty(problem), np.zeros(problem.low.shape), at.numbers
    riccati.solve(problem, work, config.knots, math.nan, duals)
    prepare(problem, layout.places, work, duals, at)
    matrices = (layout.P, numbers.P), (layout.A, at.A)
    P, A = (csc_matrix((data, of.indices, of.indptr), of.shape) for of, data in matrices)
    generator = osqp.OSQP(algebra="builtin")
    generator.setup(P, numbers.q, A, at.l, at.u, **SETTINGS, eps_abs=0.1 * config.tolerance, max_iter=100_000)
    generator.codegen(str(folder), parameters="matrices", prefix="mpc_", extension_name=None, force_rewrite=True)

    scale, column = scales(vehicle), layout.column
    names = (*STATES, ("change of port's command to the next", "N"), ("change of starboard's command to the next", "N"))
    rows = [(row.scale, f"{i}: {row.name} ({row.unit})") for i, row in enumerate(row_names(layout, scale))]
    placed = enumerate(np.argwhere(column >= 0))  # columns have the order of states and inputs
    columns = [(scale[j], f"{i}: {names[j][0]} ({names[j][1]}) at knot {k}") for i, (k, j) in placed]
    columns += [rows[i] for i in np.flatnonzero(layout.places.kind == EXCESS)]
    knots = [f"knot {k}" for k in range(1, N + 1)]
    solution = z[1:, COMMANDS:CHANGES] * scale[COMMANDS:CHANGES]
    parts = [
        ("int mpc_commands[][2]", zip(_pairs(column[1:, COMMANDS:CHANGES]), knots, strict=True)),
        ("double mpc_solution_N[][2]", zip(_pairs(solution), knots, strict=True)),
        ("double mpc_column_scale[]", columns),
        ("double mpc_row_scale[]", rows),
        ("double mpc_row_factor[]", ((s, name) for s, (_, name) in zip(at.scale, rows, strict=True))),
    ]
    defined = f"#define MPC_STAGES {N}\n#define MPC_VARIABLES {n}\n#define MPC_ROWS {m}\n"
    for name, entries in parts:
        lines = [f"  {number}, /* {what} */\n" for number, what in entries]
        defined += f"static const {name} = {{\n{''.join(lines)}}};\n"
    (folder / "mpc_layout.h").write_text(HEAD + defined, encoding="utf-8")
    return Exported(N, n, m)


def _pairs(numbers: npt.NDArray[Any]) -> list[str]:
    """Return the rows (N, 2) as initialisers in C."""
    return [f"{{{port}, {starboard}}}" for port, starboard in numbers.tolist()]
