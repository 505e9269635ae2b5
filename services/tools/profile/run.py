"""Latency profile of a controller cycle on this machine, by solver and horizon, beside the Riccati solver.

A ratio is of whole control steps, on the same problems in the same run; it means something between rows whose thrusts
are equally near the exact solution.
"""

from __future__ import annotations

import itertools
import random
from collections import Counter
from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from ltv_mpc.errors import ConfigError
from services.tools.profile import problems
from services.tools.profile.machine_description import Machine, load, machine
from services.tools.profile.measure import Candidate, Samples, measure, solver_by_name
from services.tools.profile.problems import Episode, seconds

YARDSTICK = solver_by_name("riccati")
"""Always measured: what every other row is a ratio of. It depends on no package but numpy and numba."""

WARM_UP = 20
"""Cycles of a descent that are solved before any is measured: cold caches, and what is set up at first use."""

MOST_STAGES = 400


class Spread(msgspec.Struct, frozen=True, kw_only=True):
    """Quantiles of a sample over all cycles."""

    median: float
    p90: float
    p99: float
    max: float

    @classmethod
    def of(cls, sample: Sequence[float]) -> Spread:
        """Compute the quantiles; NaN is left out."""
        known = np.array([x for x in sample if x == x])
        if not len(known):
            return cls(median=0.0, p90=0.0, p99=0.0, max=0.0)
        median, p90, p99, most = np.quantile(known, [0.5, 0.9, 0.99, 1.0]).tolist()
        return cls(median=median, p90=p90, p99=p99, max=most)


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """Measurements of one solver at one horizon."""

    solver: str
    stages: int
    horizon_s: float
    cycles: int
    cycle_us: Spread  # interleaved, as stage_us; the three states of the caches are those of measure.py
    repeated_us: Spread
    flushed_us: Spread
    stage_us: dict[str, Spread]
    iterations: Spread
    thrust_error_N: Spread  # first free knot, from the exact solution of the same QP
    status: dict[str, int]
    ratio: dict[str, float]  # interleaved: median and p99 over the reference's, at the same horizon in the same run
    repeated_ratio: dict[str, float]
    flushed_ratio: dict[str, float]


class Profile(msgspec.Struct, frozen=True, kw_only=True):
    """Measurements, the problems that were solved, and the machine."""

    rows: list[Row]
    problems: dict[str, int]  # cycles of each kind at each horizon
    machine: Machine


# --- what is asked for -----------------------------------------------------------------------------------------------


def parse_horizons(text: str) -> list[int]:
    """Parse ``default,17,34`` as numbers of stages; "default" is ``problems.DEFAULT``. Raises ``ConfigError``."""
    parts = [part.strip() for part in text.split(",")]
    stages = [int(part) if part.isdecimal() and len(part) < 6 else 0 for part in parts]
    for part, number in zip(parts, stages, strict=True):
        if part != "default" and not 1 <= number <= MOST_STAGES:
            problem = f"must be numbers of stages of {seconds(1):g} s, 1 to {MOST_STAGES}, or default, as in default,17"
            raise ConfigError("option --horizons", "", problem, value=part)
    return list(dict.fromkeys(stages))


def parse_solvers(text: str, episode: Episode) -> list[Candidate]:
    """Read ``osqp,riccati`` as solvers, each tried on ``episode``. Raises ``ConfigError``."""
    solvers = [solver_by_name(name) for name in dict.fromkeys(part.strip() for part in text.split(","))]
    for solver in solvers:
        try:
            solver.make_solver(episode.vehicle, episode.config)
        except ConfigError as error:
            raise ConfigError("option --solvers", "", error.problem, value=solver.name) from None
    return solvers


# --- measuring -------------------------------------------------------------------------------------------------------


def run(
    by_horizon: Sequence[Sequence[Episode]],
    solvers: Sequence[Candidate],
    *,
    seed: int,
    progress: Callable[[float], None],
) -> Profile:
    """Measure the yardstick and each solver on the episodes of each horizon. Raises ``ConfigError`` if none is solved.

    Parameters
    ----------
    by_horizon : the episodes of each horizon.
    solvers : measured beside the yardstick.
    seed : of the order of the solvers.
    progress : receives the share done.
    """
    candidates = YARDSTICK, *(solver for solver in solvers if solver.name != YARDSTICK.name)
    order = random.Random(seed)
    rows: list[Row] = []
    load_before = load()
    total = sum(WARM_UP + sum(episode.cycles for episode in episodes) for episodes in by_horizon)
    done = itertools.count(1)

    def advance() -> None:
        progress(next(done) / total)

    for episodes in by_horizon:
        stages = episodes[0].config.stages
        warm_up = problems.simulated(stages, 1, seed)[0]._replace(cycles=WARM_UP)
        measured = measure(episodes, candidates, warm_up=warm_up, order=order, progress=advance)
        if not measured[0].cycle_us:
            raise ConfigError("option --run", "", "has no solved cycle of the controller: name another run")
        rows += [_row(who.name, samples, measured[0]) for who, samples in zip(candidates, measured, strict=True)]
    kinds = Counter[str]()
    for episode in by_horizon[0]:
        kinds[episode.kind] += episode.cycles
    return Profile(rows=rows, problems=kinds, machine=machine(load_before))


def _row(solver: str, samples: Samples, yardstick: Samples) -> Row:
    measured, reference = _spreads(samples), _spreads(yardstick)

    def ratio(name: str) -> dict[str, float]:
        time, unit = measured[name], reference[name]
        return {"median": time.median / unit.median, "p99": time.p99 / unit.p99}

    return Row(
        solver=solver,
        stages=samples.stages,
        horizon_s=samples.horizon_s,
        cycles=len(samples.cycle_us),
        stage_us={stage: Spread.of(times) for stage, times in samples.stage_us.items()},
        status={str(status): count for status, count in samples.status.most_common()},
        ratio=ratio("cycle_us"),
        repeated_ratio=ratio("repeated_us"),
        flushed_ratio=ratio("flushed_us"),
        **measured,
    )


def _spreads(samples: Samples) -> dict[str, Spread]:
    """Return the quantiles of what has one number a cycle, by its name in a row."""
    names = "cycle_us", "repeated_us", "flushed_us", "iterations", "thrust_error_N"
    return {name: Spread.of(getattr(samples, name)) for name in names}
