"""Computing time of a cycle at the paper's two horizons, for the timing table and by stage for its figure."""

from __future__ import annotations

import random
from typing import NamedTuple

from benchmarks.paper.renderer import Run
from benchmarks.paper.settings import COMPUTING_S, LONG_S
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.resolution import settled
from ltv_mpc.vehicle.parameters import Vehicle
from services.reporting.plots.delays import CYCLE, PARTS, Percentiles, percentile_rows
from services.tools.profile import problems
from services.tools.profile.machine_description import Machine, load, machine
from services.tools.profile.measure import Samples, measure, solver_by_name
from services.tools.profile.run import WARM_UP, Spread

VEHICLE = Vehicle.load("paper")
SHIPPED = ControllerConfig()
SOLVER = solver_by_name(SHIPPED.solver)
"""Solver of the shipped controller."""


class Cycle(NamedTuple):
    """Times of the cycles at one horizon of the paper."""

    horizon_s: float  # the paper's
    reach_s: float  # in whole stages
    cycle_us: Spread
    samples: Samples


class Timed(NamedTuple):
    """Times of both horizons, and the machine."""

    cycles: list[Cycle]
    machine: Machine


def timed(cycles: int) -> Timed:
    """Measure this number of cycles at each horizon, on the problems of ``ltv-mpc profile``."""
    before = load()
    found = []
    for horizon_s in COMPUTING_S:
        config = settled(ControllerConfig(horizon_s=horizon_s), VEHICLE)
        episodes = problems.simulated(config.stages, cycles, seed=0)
        warm_up = problems.simulated(config.stages, 1, seed=0)[0]._replace(cycles=min(WARM_UP, cycles))
        (samples,) = measure(episodes, [SOLVER], warm_up=warm_up, order=random.Random(0), progress=lambda: None)
        found.append(Cycle(horizon_s, config.reach_s, Spread.of(samples.cycle_us), samples))
    return Timed(found, machine(before))


def run(of: Timed) -> Run:
    """Return the percentiles of the cycles of the longer horizon, in the form that figures draw."""
    (long,) = (cycle for cycle in of.cycles if cycle.horizon_s == LONG_S)
    samples = long.samples
    stages = {CYCLE: Percentiles()}
    for us in samples.cycle_us:
        stages[CYCLE].add(us / 1e3)
    for stage, names in PARTS.items():
        laps = [samples.stage_us[name] for name in names if name in samples.stage_us]
        stages[stage] = Percentiles()
        for lap in zip(*laps, strict=True):
            stages[stage].add(sum(lap) / 1e3)
    return Run("timing", {"stages": percentile_rows(stages)})
