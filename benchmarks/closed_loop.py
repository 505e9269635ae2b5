"""One QP a cycle, or a few, against the converged optimum in closed loop: what is lost by not iterating.

    PYTHON -m benchmarks.closed_loop --out DIR [--seeds N] [--duration-s T] [--workers N]

PYTHON has casadi beside what the project needs. The paper's descent, state known, 5 s of horizon. Each seed is flown
by the controller with one QP a cycle, two and three, and by one that differs in this alone: its commands are those to
which IPOPT converges on the nonlinear problem (``optimum.py``), started from what the QP came to, the best start that
there is. The cost of a flight is the controller's own, summed over what really happened on its cycles' grid:

    J = sum over cycles of  w |p - ref|^2 + r |F / max|^2 + s |dF / max|^2

The figure is the ratio of summed costs over all seeds, with its 95 % interval (bootstrap over pairs). Single seeds may
fall below 1: the two go to other local optima, and none of them knows what lies beyond its horizon.
Flights that DIR has already are not flown again.
"""

from __future__ import annotations

import argparse
import functools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import Progress

from benchmarks import along
from benchmarks.loop import STEP_NS, Loop, Outcome, run_config
from benchmarks.optimum import Optimum
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import CHANGES, COMMANDS
from ltv_mpc.control.solvers import Result, Solver, make
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Vehicle
from services.run.provenance import provenance_table
from services.run.run_config import RunConfig
from services.tools.batch.executor import run_each
from services.tools.batch.results_store import open_store
from services.tools.campaign.trial import version_of

FIRST_SEED = 500
RESAMPLES = 10_000
SPREAD = (0.0, 0.25, 0.5, 0.75, 1.0)

OPTIMUM = "optimum"
NAMES = ("1", "2", "3", OPTIMUM)
"""QPs a cycle (``sqp_iterations``), and what IPOPT makes of the first."""


class Converged:
    """Solver of the settings, followed by IPOPT from its solution."""

    def __init__(self, inner: Solver, optimum: Optimum) -> None:
        self._inner, self._optimum = inner, optimum
        self.cycles = self.converged = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def build(self, problem: Problem) -> None:
        """Build the QP of the inner solver."""
        self._problem = problem
        self._inner.build(problem)

    def solve(self) -> Result:
        """Return IPOPT's commands if it converges to at most the QP's cost, else the QP's."""
        answer, (lin, target), optimum = self._inner.solve(), along.now(), self._optimum
        self.cycles += 1
        X0, C, scale = lin.X[0], lin.C, optimum.limits.thrust_scale
        first = lin.U + answer.z[:, COMMANDS:CHANGES] * scale
        commands, done = optimum.solve(optimum.roll(X0, first, C), first, C, target)
        self.converged += done
        if done and optimum.cost(X0, commands, C, target) <= optimum.cost(X0, first, C, target):
            return Result(along.solution(self._problem, commands, lin.U, optimum.limits), answer.solve)
        return answer


def cost(of: RunConfig, flown: Outcome) -> float:
    """Return the cost J of a flight."""
    weights = of.controller.weights
    scale = HorizonLimits.from_vehicle(of.vehicle, of.controller.period_s).thrust_scale
    every = of.controller.period_ns // STEP_NS
    distance, f = flown.distance_m[every - 1 :: every], flown.commands_N[every - 1 :: every] / scale
    change = np.diff(f, axis=0, prepend=0.0)
    total = weights.position_per_m2 * distance @ distance
    return float(total + weights.thrust * np.sum(f * f) + weights.thrust_change * np.sum(change * change))


class Flight(NamedTuple):
    """Result of one descent: cost, mean distance (m), mean |F| (N), share of cycles in which IPOPT converged."""

    cost: float
    mean_m: float
    mean_abs_N: float
    converged: float = 0.0


def fly(of: RunConfig, optimum: Optimum | None) -> Flight:
    """Fly one descent, with IPOPT after the QP if there is one."""
    made: list[Converged] = []

    def make_converged(vehicle: Vehicle, config: ControllerConfig) -> Solver:
        assert optimum is not None
        made.append(Converged(make(vehicle, config), optimum))
        return made[-1]

    make_solver = make if optimum is None else make_converged
    controller = Controller(of.vehicle, of.reference, of.controller, make_solver=make_solver)
    outcome = Loop(run_config=of, controller=controller).fly()
    cycles = sum(one.cycles for one in made)
    share = sum(one.converged for one in made) / cycles if cycles else 0.0
    return Flight(cost(of, outcome), outcome.mean_m, outcome.mean_abs_N, share)


def ratio(pairs: Array) -> tuple[float, float, float]:
    """Return the sum of ours over the sum of the optimum's (K, 2), and its 95 % interval."""
    drawn = np.random.default_rng(0).integers(0, len(pairs), (RESAMPLES, len(pairs)))
    sums = pairs[drawn].sum(axis=1)
    low, high = np.quantile(sums[:, 0] / sums[:, 1], [0.025, 0.975])
    return float(pairs[:, 0].sum() / pairs[:, 1].sum()), float(low), float(high)


class Job(NamedTuple):
    """Flight of one seed with one of ``NAMES``."""

    seed: int
    name: str
    duration_s: float


@functools.cache
def _optimum() -> Optimum:
    """Made once by each process: it takes IPOPT some seconds."""
    here = run_config()
    return Optimum(here.vehicle, here.controller)


def flight(job: Job) -> Flight:
    """Fly it."""
    best = job.name == OPTIMUM
    iterations = f"controller.sqp_iterations={1 if best else job.name}"
    of = run_config(f"run.seed={job.seed}", f"run.duration_s={job.duration_s}", iterations)
    return fly(of, _optimum() if best else None)


def main() -> None:
    """Fly, keep, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--duration-s", type=float, default=200.0)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    jobs = [Job(seed, name, options.duration_s) for seed in seeds for name in NAMES]
    settings = {"duration_s": options.duration_s, "version": version_of(provenance_table())}
    with open_store(options.out, settings) as store, Progress(console=Console(stderr=True)) as progress:
        missing = [job for job in jobs if _key(job) not in store.keys]
        task = progress.add_task("flights", total=len(jobs), completed=len(jobs) - len(missing))
        for place, flown in run_each(flight, missing, workers=options.workers):
            store.append(_key(missing[place]), flown._asdict())
            progress.advance(task)
        found = dict(store.results())
    print(table({seed: {name: found[_key(Job(seed, name, 0.0))] for name in NAMES} for seed in seeds}))


def _key(job: Job) -> str:
    return f"seed {job.seed}, {job.name}"


def table(kept: dict[int, dict[str, Any]]) -> str:
    """Return the table of ratios to the optimum, paired by seed."""
    columns = "ratio of summed costs (95 %) | by seed: least, quartiles, most | distance (m) | abs F (N)"
    lines = [f"| mean of {len(kept)} seeds | {columns} |", "|---|---|---|---|---|"]
    for name in NAMES:
        flown = [(row[name], row[OPTIMUM]) for row in kept.values()]
        title, said, quartiles = name, "", ""
        if name != OPTIMUM:
            pairs = np.array([[one["cost"], best["cost"]] for one, best in flown])
            mean, low, high = ratio(pairs)
            title, said = f"{name} QP a cycle", f"{mean:.3f} ({low:.3f} to {high:.3f})"
            quartiles = ", ".join(f"{x:.2f}" for x in np.quantile(pairs[:, 0] / pairs[:, 1], SPREAD))
        metres, newtons = (np.mean([one[key] for one, _ in flown]) for key in ("mean_m", "mean_abs_N"))
        lines.append(f"| {title} | {said} | {quartiles} | {metres:.4f} | {newtons:.1f} |")
    share = np.mean([row[OPTIMUM]["converged"] for row in kept.values()])
    return "\n".join([*lines, f"IPOPT converged in {100 * share:.1f} % of its cycles"])


if __name__ == "__main__":
    main()
