"""Exported C code on random problems from nothing: error of its thrusts, iterations and time.

    .venv/bin/python -m benchmarks.exported_c [--problems N] [--first-seed N] [--vehicle NAME] [--folder DIR]

The problems are the QPs of the first cycles of ``benchmarks.hard_problems`` without limits of the motion, in random
order. The exact solution is PIQP's. The code is built by the system's compiler, in the folder or a temporary one.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.hard_problems import CYCLES, VEHICLES, craft, draw
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.nominal_model import advance
from ltv_mpc.control.qp import QP
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.solvers import Solver, make, solve_qp
from ltv_mpc.control.solvers.osqp import OsqpSolver
from ltv_mpc.control.solvers.recorder import RecordingSolver
from ltv_mpc.messages import Array
from ltv_mpc.references import Point
from ltv_mpc.vehicle.flow import STATES
from services.tools.c_code import export, loaded_solver


class Solved(NamedTuple):
    """Result of the exported code on each problem."""

    error_N: Array  # of the first free thrusts, the larger one
    status: Array  # of OSQP, 1 if solved
    iterations: Array
    us: Array  # processor time


def problems(vehicle: str, count: int, first_seed: int = 0) -> list[QP]:
    """Return the QPs of the cycles of random problems, in random order."""
    model, _, _ = craft(vehicle)
    qps: list[QP] = []
    for seed in range(first_seed, first_seed + count):
        config, estimate = draw(seed, vehicle, limited=False)
        made: list[RecordingSolver] = []

        def make_recorded(*settings: object, made: list[RecordingSolver] = made) -> Solver:
            made.append(RecordingSolver(make(*settings)))  # type: ignore[arg-type]
            return made[-1]

        controller = Controller(model, Point(north_m=0.0, east_m=0.0), config, make_solver=make_recorded)
        for _ in range(CYCLES):
            plan = controller.plan(estimate)
            solver = made[-1].solver
            assert isinstance(solver, OsqpSolver)
            qps.append(solver.problem())
            estimate = advance(model, estimate, plan, duration_s=config.period_s)
    np.random.default_rng(first_seed).shuffle(qps)  # type: ignore[arg-type]
    return qps[:count]


def solve(vehicle: str, qps: list[QP], folder: Path) -> Solved:
    """Export the code into ``folder``, build it, and solve the problems with it."""
    model, _, _ = craft(vehicle)
    config = settled(ControllerConfig(), model)
    solver, nominal = loaded_solver(model, config)
    export(folder, solver, nominal, config)
    subprocess.run(["make", "-C", str(folder)], check=True, capture_output=True, timeout=300)
    numbers = [part for qp in qps for part in (qp.A.data, qp.q, qp.l, qp.u)]
    (folder / "problems.bin").write_bytes(np.concatenate(numbers).tobytes())
    command = [str(folder / "emosqp"), str(folder / "problems.bin")]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, timeout=600).stdout
    status, iterations, port, starboard, us = np.array([line.split() for line in printed.splitlines()], dtype=float).T
    scale = solver.form.limits.thrust_scale
    exact = [solve_qp(qp, "piqp").x[STATES : STATES + 2] * scale for qp in qps]
    error = np.abs(np.column_stack([port, starboard]) - exact).max(axis=1)
    return Solved(error, status, iterations, us)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--vehicle", choices=VEHICLES, default="paper")
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        solved = solve(options.vehicle, problems(options.vehicle, options.problems, options.first_seed), folder)
    print(
        "| vehicle | problems | solved | largest error (N) | iterations: median, 90 %, most | ms: median, 90 %, most |"
    )
    print("|---|---|---|---|---|---|")
    iterations, ms = (np.quantile(part, [0.5, 0.9, 1.0]) for part in (solved.iterations, solved.us / 1000))
    print(
        f"| {options.vehicle} | {len(solved.status)} | {np.count_nonzero(solved.status == 1)} | "
        f"{solved.error_N.max():.4f} | {', '.join(f'{n:.0f}' for n in iterations)} | "
        f"{', '.join(f'{t:.1f}' for t in ms)} |"
    )


if __name__ == "__main__":
    main()
