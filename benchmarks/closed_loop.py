"""One QP a cycle against the converged optimum in closed loop: what is lost by not iterating.

    PYTHON -m benchmarks.closed_loop --out FILE.json [--seeds N] [--duration-s T] [--workers N]

PYTHON has casadi beside what the project needs. The paper's descent, state known, 5 s of horizon. Each seed is flown
twice, by the controller and by one that differs in this alone: its commands are those to which IPOPT converges on the
nonlinear problem (``optimum.py``), started from what the QP came to, the best start that there is. The cost of a flight
is the controller's own, summed over what really happened on its cycles' grid:

    J = sum over cycles of  w |p - ref|^2 + r |F / max|^2 + s |dF / max|^2

The figure is the ratio of summed costs over all seeds, with its 95 % interval (bootstrap over pairs). Single seeds may
fall below 1: the two go to other local optima, and none of them knows what lies beyond its horizon.
Seeds that FILE has already are not flown again.
"""

from __future__ import annotations

import argparse
import functools
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import Progress

from benchmarks.loop import STEP_NS, Loop, Outcome, situation
from benchmarks.optimum import Optimum
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.horizon import Linearisation
from ltv_mpc.control.limits import ThrustLimits
from ltv_mpc.control.scales import settled
from ltv_mpc.control.solvers.solver import Answer, Solver
from ltv_mpc.signals import Array
from services.measure.batch import each
from services.run.situation import Situation

FIRST_SEED = 500
RESAMPLES = 10_000


class Converged:
    """The settings' solver, and IPOPT from where it ended."""

    def __init__(self, inner: Solver, optimum: Optimum) -> None:
        self._inner, self._optimum = inner, optimum
        self._lin: Linearisation
        self._target: Array
        self.cycles = self.converged = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def build(self, lin: Linearisation, target: Array) -> None:
        """As the inner one."""
        self._lin, self._target = lin, target
        self._inner.build(lin, target)

    def solve(self) -> Answer:
        """IPOPT's commands where it converges to no more than the QP's cost, else the QP's."""
        answer, lin, optimum = self._inner.solve(), self._lin, self._optimum
        self.cycles += 1
        X0, C, target = lin.X[0], lin.C, self._target
        start = optimum.roll(X0, answer.commands, C)
        commands, done = optimum.solve(start, answer.commands, C, target)
        self.converged += done
        if done and optimum.cost(X0, commands, C, target) <= optimum.cost(X0, answer.commands, C, target):
            return Answer(commands, answer.solve)
        return answer


def cost(of: Situation, flown: Outcome) -> float:
    """J of a flight."""
    weights = settled(of.scenario.controller, of.vehicle).weights
    scale = ThrustLimits.of(of.vehicle, of.scenario.controller.period_s).scale
    every = of.scenario.controller.period_ns // STEP_NS
    distance, f = flown.distance_m[every - 1 :: every], flown.commands_N[every - 1 :: every] / scale
    change = np.diff(f, axis=0, prepend=0.0)
    total = weights.position_per_m2 * distance @ distance
    return float(total + weights.thrust * np.sum(f * f) + weights.thrust_change * np.sum(change * change))


def fly(of: Situation, optimum: Optimum | None) -> tuple[float, Outcome, float]:
    """Cost, flight, and the share of cycles in which IPOPT converged."""
    controller = Controller(of.vehicle, of.reference, of.scenario.controller)
    made: list[Converged] = []
    if optimum is not None:

        def converged(inner: Solver) -> Solver:
            made.append(Converged(inner, optimum))
            return made[-1]

        controller.solve_with(converged)
    outcome = Loop(situation=of, controller=controller).fly()
    cycles = sum(one.cycles for one in made)
    return cost(of, outcome), outcome, sum(one.converged for one in made) / cycles if cycles else 0.0


def ratio(pairs: Array) -> tuple[float, float, float]:
    """Sum of ours over sum of the optimum's (K, 2), and its 95 % interval."""
    drawn = np.random.default_rng(0).integers(0, len(pairs), (RESAMPLES, len(pairs)))
    sums = pairs[drawn].sum(axis=1)
    low, high = np.quantile(sums[:, 0] / sums[:, 1], [0.025, 0.975])
    return float(pairs[:, 0].sum() / pairs[:, 1].sum()), float(low), float(high)


class Job(NamedTuple):
    """One seed, flown twice."""

    seed: int
    duration_s: float


@functools.cache
def _optimum() -> Optimum:
    """Made once by each process: it takes IPOPT some seconds."""
    here = situation()
    return Optimum(here.vehicle, here.scenario.controller)


def pair(job: Job) -> dict[str, float]:
    """What FILE keeps of it."""
    here = situation(f"run.seed={job.seed}", f"run.duration_s={job.duration_s}")
    (ours, flown, _), (theirs, best, share) = fly(here, None), fly(here, _optimum())
    return {
        "ours": ours,
        "optimum": theirs,
        "ours_m": flown.mean_m,
        "optimum_m": best.mean_m,
        "converged": share,
    }


def main() -> None:
    """Fly, keep, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--duration-s", type=float, default=200.0)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    kept: dict[str, Any] = json.loads(options.out.read_text()) if options.out.exists() else {}
    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    jobs = [Job(seed, options.duration_s) for seed in seeds if str(seed) not in kept]
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("pairs of descents", total=options.seeds, completed=options.seeds - len(jobs))
        for place, row in each(pair, jobs, workers=options.workers):
            kept[str(jobs[place].seed)] = row
            options.out.write_text(json.dumps(kept, indent=1) + "\n")
            progress.advance(task)
    pairs = np.array([[row["ours"], row["optimum"]] for row in kept.values()])
    mean, low, high = ratio(pairs)
    single = np.quantile(pairs[:, 0] / pairs[:, 1], [0.0, 0.25, 0.5, 0.75, 1.0])
    print(f"ratio of summed costs over {len(pairs)} seeds: {mean:.4f} (95 %: {low:.4f} to {high:.4f})")
    print(f"by seed, least, quartiles, most: {', '.join(f'{x:.3f}' for x in single)}")
    metres = [np.mean([row[name] for row in kept.values()]) for name in ("ours_m", "optimum_m")]
    print(f"mean distance: {metres[0]:.4f} m, optimum {metres[1]:.4f} m")
    print(f"IPOPT converged in {100 * np.mean([row['converged'] for row in kept.values()]):.1f} % of its cycles")


if __name__ == "__main__":
    main()
