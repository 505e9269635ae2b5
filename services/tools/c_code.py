"""Export of the controller's QP as C code that OSQP generates, without allocation or libraries.

The folder contains OSQP's sources, and mpc_solve.c, which solves any QP of the vehicle from nothing. Every cycle has
the same pattern, and mpc_layout.h describes the place of each number. mpc_solve.c scales the rows as the controller
does (solvers/osqp.py), by the limits that the dual shows to be active after each batch of iterations. The controller's
first guess is not exported, so a solve takes hundreds of iterations instead of a few: docs/notes/exported-c.md.

The sample, emosqp.c, solves the exported problem and prints the first free thrusts. With the name of a file it solves
the problems in it, each as the numbers A, q, l and u.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy.typing as npt
import osqp
from scipy.sparse import csc_matrix, triu

from ltv_mpc.control.config import STAGE_NS, ControllerConfig, ResolvedConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.solvers import Solver, make
from ltv_mpc.control.solvers.osqp import (
    ACTIVE,
    BATCH,
    CHECK,
    CONSTANT_BATCHES,
    EQUALITY_ROW,
    GRADIENT,
    LIMIT_ROW,
    MAX_LIMIT_ROW,
    OsqpSolver,
)
from ltv_mpc.control.solvers.osqp_workspace import BASE_SETTINGS
from ltv_mpc.control.solvers.recorder import RecordingSolver
from ltv_mpc.control.solvers.sparse import STAGE_VARIABLES
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, Estimate
from ltv_mpc.references import Point
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Vehicle

PREFIX = "mpc_"

MAX_ITERATIONS = 500_000
"""Limit of iterations of the exported code, four times that of the hardest problem in docs/notes/exported-c.md."""

PRECISION = 0.1
"""Tolerance of the exported code over the controller's, whose first guess is better than its tolerance."""

SAMPLE = """/* Without an argument: solves the exported problem.
   Prints status, iterations, the first free thrusts (N) and the processor time (us).
   With the name of a file: solves each of its problems, stored as the doubles A, q, l and u.
   Prints the same, with the changes of the thrusts from the trajectory linearised along. */
#include <stdio.h>
#include <time.h>
#include "mpc_solve.h"
#include "mpc_sample.h"

static void solve(const OSQPFloat *A, const OSQPFloat *q, const OSQPFloat *l, const OSQPFloat *u, double port,
                  double starboard) {
  clock_t started = clock();
  OSQPInt status = mpc_solve(A, q, l, u);
  double us = 1e6 * (double)(clock() - started) / CLOCKS_PER_SEC;
  printf("%d %d %.17g %.17g %.0f\\n", (int)status, (int)mpc_iterations,
         port + MPC_PORT_SCALE * mpc_solver.solution->x[MPC_FIRST_PORT],
         starboard + MPC_STARBOARD_SCALE * mpc_solver.solution->x[MPC_FIRST_STARBOARD], us);
}

int main(int argc, char **argv) {
  static OSQPFloat of[MPC_ENTRIES + MPC_VARIABLES + 2 * MPC_ROWS];
  FILE *file;
  if (argc < 2) {
    solve(mpc_sample_A, mpc_sample_q, mpc_sample_l, mpc_sample_u, MPC_PORT_BEFORE, MPC_STARBOARD_BEFORE);
    return 0;
  }
  file = fopen(argv[1], "rb");
  if (!file) {
    perror(argv[1]);
    return 2;
  }
  while (fread(of, sizeof of, 1, file) == 1)
    solve(of, of + MPC_ENTRIES, of + MPC_ENTRIES + MPC_VARIABLES, of + MPC_ENTRIES + MPC_VARIABLES + MPC_ROWS, 0, 0);
  fclose(file);
  return 0;
}
"""

SOLVE_HEADER = """/* Solve any QP of the vehicle: see mpc_layout.h for the numbers. */
#ifndef MPC_SOLVE_H
#define MPC_SOLVE_H
#include "osqp.h"
#include "mpc_workspace.h"
#include "mpc_layout.h"

/* Solves from x = 0; returns OSQP's status, 1 if solved, or minus OSQP's error. x is mpc_solver.solution->x. */
OSQPInt mpc_solve(const OSQPFloat *A, const OSQPFloat *q, const OSQPFloat *l, const OSQPFloat *u);

/* iterations of the last call */
extern OSQPInt mpc_iterations;
#endif
"""

SOLVE = """#include <math.h>
#include "mpc_solve.h"

OSQPInt mpc_iterations;

static const int row_of_entry[MPC_ENTRIES] = {entry_rows};
static OSQPFloat scale[MPC_ROWS], x[MPC_VARIABLES], y[MPC_ROWS];
static OSQPFloat scaled_A[MPC_ENTRIES], scaled_l[MPC_ROWS], scaled_u[MPC_ROWS], scaled_y[MPC_ROWS];

/* Scales the rows by the active limits; returns whether a scale has changed. */
static int rescale(OSQPFloat size, const OSQPFloat *A, const OSQPFloat *l, const OSQPFloat *u) {{
  const OSQPFloat inactive = fmin(MPC_ROW_LIMIT * size, MPC_ROW_LIMIT_MAX);
  int changed = 0;
  for (int i = 0; i < MPC_ROWS; i++) {{
    OSQPFloat s = i < MPC_EQUALITIES ? MPC_ROW_DYNAMICS : fabs(y[i]) > 1e-9 ? inactive * MPC_ROW_ACTIVE : inactive;
    changed |= s != scale[i];
    scale[i] = s;
    scaled_l[i] = l[i] * s;
    scaled_u[i] = u[i] * s;
    scaled_y[i] = y[i] / s;
  }}
  for (int i = 0; i < MPC_ENTRIES; i++) scaled_A[i] = A[i] * scale[row_of_entry[i]];
  return changed;
}}

OSQPInt mpc_solve(const OSQPFloat *A, const OSQPFloat *q, const OSQPFloat *l, const OSQPFloat *u) {{
  OSQPFloat gradient = 0, size;
  OSQPInt error = 0, length = MPC_BATCH;
  for (int i = 0; i < MPC_VARIABLES; i++) gradient = fmax(gradient, fabs(q[i])), x[i] = 0;
  for (int i = 0; i < MPC_ROWS; i++) y[i] = scale[i] = 0;
  size = fmax(1, sqrt(gradient / MPC_GRADIENT));
  mpc_solver.settings->eps_abs = MPC_TOLERANCE * size;
  mpc_iterations = 0;
  for (int batch = 1;; batch++) {{
    if (rescale(size, A, l, u)) {{
      if ((error = osqp_update_data_mat(&mpc_solver, 0, 0, 0, scaled_A, 0, MPC_ENTRIES))) return -error;
      if ((error = osqp_update_data_vec(&mpc_solver, q, scaled_l, scaled_u))) return -error;
      if ((error = osqp_warm_start(&mpc_solver, x, scaled_y))) return -error;
    }}
    mpc_solver.settings->max_iter = length;
    if ((error = osqp_solve(&mpc_solver))) return -error;
    mpc_iterations += mpc_solver.info->iter;
    if (mpc_solver.info->status_val == OSQP_SOLVED || mpc_iterations >= MPC_MAX_ITERATIONS) break;
    for (int i = 0; i < MPC_VARIABLES; i++) x[i] = mpc_solver.solution->x[i];
    for (int i = 0; i < MPC_ROWS; i++) y[i] = mpc_solver.solution->y[i] * scale[i];
    if (batch > MPC_CONSTANT_BATCHES) length *= 2;
  }}
  return mpc_solver.info->status_val;
}}
"""

MAKEFILE = """# emosqp: the sample; libemosqp.a: OSQP's sources and mpc_solve.c, for your own program.
CC ?= gcc
CFLAGS ?= -O2
INCLUDES = -I./inc/public -I./inc/private -I.
objects := $(patsubst %.c,%.o,$(wildcard src/*.c) mpc_workspace.c mpc_solve.c)

emosqp: emosqp.c libemosqp.a
\t$(CC) $(CFLAGS) $(INCLUDES) -o $@ $^ -lm

libemosqp.a: $(objects)
\tar rcs $@ $^

%.o: %.c
\t$(CC) $(CFLAGS) $(INCLUDES) -c $< -o $@

.PHONY: clean
clean:
\trm -f $(objects) libemosqp.a emosqp
"""

LAYOUT = """/* Meaning of the numbers of the QP: minimise 1/2 x'Px + q'x subject to l <= Ax <= u.

   x: for each of MPC_STAGES stages {width} numbers, deviations from the trajectory linearised along, divided by
      {scales} (n, e, u, v, psi, r, delivered port and starboard thrust, commanded port and starboard thrust);
      then the terminal velocity, north and east (m/s).
   rows: {states} of dynamics a stage and 2 of the terminal velocity; then 2 of slew a stage, then 2 of box a stage.
   A: its MPC_ENTRIES stored entries, by column.
   mpc_solve multiplies the dynamics by MPC_ROW_DYNAMICS, an inactive limit by MPC_ROW_LIMIT and more with the gradient,
      and an active one by MPC_ROW_ACTIVE more. */
#ifndef MPC_LAYOUT_H
#define MPC_LAYOUT_H
#define MPC_STAGES {stages}
/* times of the knots after the plan's start (s), MPC_STAGES + 1 of them */
#define MPC_KNOTS_S {knots}
#define MPC_VARIABLES {variables}
#define MPC_ROWS {rows}
#define MPC_EQUALITIES {equalities}
#define MPC_ENTRIES {entries}
#define MPC_TOLERANCE {tolerance!r}
#define MPC_MAX_ITERATIONS {max_iterations}
#define MPC_BATCH {batch}
#define MPC_CONSTANT_BATCHES {constant_batches}
#define MPC_GRADIENT {gradient!r}
#define MPC_ROW_LIMIT_MAX {limit_max!r}
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
#endif
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
    # Far off and abeam, so that the solution differs from the nominal trajectory, and limits are active.
    controller.plan(Estimate.at_rest(north_m=-3.0, east_m=2.0, heading_rad=1.0))
    return solver, recorded[0].lin.U[1]


def export(folder: Path, solver: OsqpSolver, nominal: Array, config: ResolvedConfig) -> Exported:
    """Write the code into ``folder``, over existing files; ``solver`` and ``nominal`` come from ``loaded_solver``."""
    result = solver.solve()
    qp = solver.problem()
    settings = {**BASE_SETTINGS, "alpha": 1.0, "check_termination": CHECK, "max_iter": BATCH}
    generator = osqp.OSQP(algebra="builtin")
    P, A = csc_matrix(triu(qp.P, format="csc")), csc_matrix(qp.A)
    generator.setup(P, qp.q.copy(), A.copy(), qp.l.copy(), qp.u.copy(), **settings)
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
            equalities=form.equalities,
            entries=qp.A.nnz,
            tolerance=PRECISION * config.tolerance,
            max_iterations=MAX_ITERATIONS,
            batch=BATCH,
            constant_batches=CONSTANT_BATCHES,
            gradient=GRADIENT,
            limit_max=MAX_LIMIT_ROW,
            dynamics=EQUALITY_ROW,
            limit=LIMIT_ROW,
            active=ACTIVE,
            port=STATES,
            starboard=STATES + 1,
            port_scale=float(scale[0]),
            starboard_scale=float(scale[1]),
            port_before=float(nominal[0]),
            starboard_before=float(nominal[1]),
        ),
        encoding="utf-8",
    )
    sources = {
        "mpc_solve.h": SOLVE_HEADER,
        "mpc_solve.c": SOLVE.format(entry_rows=_array(qp.A.indices)),
        "mpc_sample.h": "".join(
            f"static const double mpc_sample_{name}[] = {_array(numbers)};\n"
            for name, numbers in (("A", qp.A.data), ("q", qp.q), ("l", qp.l), ("u", qp.u))
        ),
        "emosqp.c": SAMPLE,
        "Makefile": MAKEFILE,
    }
    for name, text in sources.items():
        (folder / name).write_text(text, encoding="utf-8")
    return Exported(form.stages, form.variables, form.rows, result.commands[1])


def _array(numbers: npt.NDArray[Any]) -> str:
    """Return the numbers as the initialiser of an array in C."""
    return "{" + ", ".join(repr(number) for number in numbers.tolist()) + "}"
