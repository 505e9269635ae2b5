"""How long a controller cycle takes on this machine: by solver, formulation and horizon, beside PIQP on the sparse QP.

A ratio is of whole control steps, on the same problems in the same run; it means something between rows whose thrusts
are equally near the exact solution.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from ltv_mpc.errors import ConfigError
from services.measure import profile_problems as problems
from services.measure.profile_machine import Machine, load, machine
from services.measure.profile_measuring import Pair, Samples, measure
from services.measure.profile_problems import Episode, seconds

YARDSTICK = Pair("piqp", "sparse")
"""Always measured: what every other row is a ratio of."""

RELAXED = Pair("piqp", "sparse", tolerance=1e-6)
"""Always measured, too: the yardstick at the quality that is asked of the others, 0.1 N in 99 % of the cycles."""

FORMULATIONS = ("sparse", "partial", "condensed")
"""What ``all`` stands for; ``auto`` is one of these."""

WARM_UP = 20
"""Cycles of a descent that are solved before any is measured: cold caches, and what is set up at first use."""

MOST_STAGES = 400


class Spread(msgspec.Struct, frozen=True, kw_only=True):
    """Of a sample over all cycles."""

    median: float
    p90: float
    p99: float
    max: float

    @classmethod
    def of(cls, sample: Sequence[float]) -> Spread:
        """NaN is left out."""
        known = np.array([x for x in sample if x == x])
        if not len(known):
            return cls(median=0.0, p90=0.0, p99=0.0, max=0.0)
        median, p90, p99, most = np.quantile(known, [0.5, 0.9, 0.99, 1.0]).tolist()
        return cls(median=median, p90=p90, p99=p99, max=most)


class Ratio(msgspec.Struct, frozen=True, kw_only=True):
    """Time of a cycle over that of PIQP on the sparse QP, at the same horizon in the same run."""

    median: float
    p99: float


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One solver and formulation at one horizon."""

    solver: str
    formulation: str
    tolerance: float | None  # where another than the solver's own was set
    stages: int
    horizon_s: float
    cycles: int
    cycle_us: Spread
    stage_us: dict[str, Spread]
    iterations: Spread
    thrust_error_N: Spread  # first free knot, from the exact solution of the same QP
    status: dict[str, int]
    ratio: Ratio

    @property
    def name(self) -> str:
        """For a person."""
        return f"{self.solver} {self.formulation}" + ("" if self.tolerance is None else f" {self.tolerance:g}")


class Profile(msgspec.Struct, frozen=True, kw_only=True):
    """What was measured, on which problems and where."""

    rows: list[Row]
    problems: dict[str, int]  # cycles of each kind at each horizon
    machine: Machine


class Measured(msgspec.Struct, frozen=True, kw_only=True):
    """The profile, and the samples that it sums up, in the order of its rows."""

    profile: Profile
    samples: list[Samples]


# --- what is asked for -----------------------------------------------------------------------------------------------


def parse_horizons(text: str) -> list[int]:
    """``17,34`` as numbers of stages. Raises ``ConfigError``."""
    parts = [part.strip() for part in text.split(",")]
    stages = [int(part) if part.isdecimal() and len(part) < 6 else 0 for part in parts]
    for part, number in zip(parts, stages, strict=True):
        if not 1 <= number <= MOST_STAGES:
            problem = f"must be numbers of stages of {seconds(1):g} s, 1 to {MOST_STAGES}, as in 17,34"
            raise ConfigError("option --horizons", "", problem, value=part)
    return list(dict.fromkeys(stages))


def parse_pairs(solvers: str, formulation: str, episode: Episode) -> tuple[list[Pair], list[str]]:
    """The pairs to measure, the yardstick first, and what was left out, in words. Raises ``ConfigError``.

    A formulation that a solver does not have is left out; ``episode`` is where it is tried.
    """
    if formulation not in (*FORMULATIONS, "auto", "all"):
        problem = f"must be one of {', '.join((*FORMULATIONS, 'auto', 'all'))}"
        raise ConfigError("option --formulation", "", problem, value=formulation)
    wanted = FORMULATIONS if formulation == "all" else (formulation,)
    pairs, left_out = [YARDSTICK, RELAXED], []
    for solver in dict.fromkeys(part.strip() for part in solvers.split(",")):
        refusals = {name: _refusal(Pair(solver, name), episode) for name in (*FORMULATIONS, "auto")}
        if all(refusals.values()):
            raise ConfigError("option --solvers", "", refusals["sparse"], value=solver)
        pairs += [Pair(solver, name) for name in wanted if not refusals[name]]
        left_out += [f"{solver} {name} left out: {refusals[name]}" for name in wanted if refusals[name]]
    if len(pairs) == 2 and left_out:
        raise ConfigError("option --formulation", "", f"none of {solvers} has it", value=formulation)
    if refusal := _refusal(YARDSTICK, episode):
        raise ConfigError("option --solvers", "", f"always measured: {refusal}", value=YARDSTICK.solver)
    return list(dict.fromkeys(pairs)), left_out


def _refusal(pair: Pair, episode: Episode) -> str:
    """Why there is no such controller; empty where there is."""
    try:
        pair.controller(episode)
    except ConfigError as error:
        return error.problem
    return ""


# --- measuring -------------------------------------------------------------------------------------------------------


def run(
    by_horizon: Sequence[Sequence[Episode]], pairs: Sequence[Pair], *, seed: int, progress: Callable[[], None]
) -> Measured:
    """Measure each pair on the episodes of each horizon. Raises ``ConfigError`` where no cycle was solved."""
    order = random.Random(seed)
    rows, samples = [], []
    load_before = load()
    for episodes in by_horizon:
        stages = episodes[0].config.stages
        (warm_up,) = problems.simulated(stages, 1, seed)[:1]
        warm_up = warm_up._replace(cycles=WARM_UP)
        measured = measure(episodes, pairs, warm_up=warm_up, order=order, progress=progress)
        if not measured[0].cycle_us:
            raise ConfigError("option --run", "", "holds no cycle of the controller that was solved")
        rows += _rows(pairs, measured)
        samples += measured
    kinds = dict.fromkeys((episode.kind for episode in by_horizon[0]), 0)
    for episode in by_horizon[0]:
        kinds[episode.kind] += episode.cycles
    profile = Profile(rows=rows, problems=kinds, machine=machine(load_before))
    return Measured(profile=profile, samples=samples)


def _rows(pairs: Sequence[Pair], measured: Sequence[Samples]) -> list[Row]:
    yardstick = Spread.of(measured[pairs.index(YARDSTICK)].cycle_us)
    return [_row(pair, samples, yardstick) for pair, samples in zip(pairs, measured, strict=True)]


def _row(pair: Pair, samples: Samples, yardstick: Spread) -> Row:
    cycle = Spread.of(samples.cycle_us)
    return Row(
        solver=pair.solver,
        formulation=pair.formulation,
        tolerance=pair.tolerance,
        stages=samples.stages,
        horizon_s=seconds(samples.stages),
        cycles=len(samples.cycle_us),
        cycle_us=cycle,
        stage_us={stage: Spread.of(times) for stage, times in samples.stage_us.items()},
        iterations=Spread.of(samples.iterations),
        thrust_error_N=Spread.of(samples.thrust_error_N),
        status={str(status): count for status, count in samples.status.most_common()},
        ratio=Ratio(median=cycle.median / yardstick.median, p99=cycle.p99 / yardstick.p99),
    )
