"""Hard scenarios: the horizon's stages as they are against stages that grow; state known.

    .venv/bin/python -m benchmarks.hard [--seeds N] [--first-seed N] [--only TEXT] [--workers N] [--out FILE.json]

Each on the descent's currents: the bow 180 deg from where the current wants it and 1 m off; 5 m off with any heading; a
port thruster that delivers half of what it reports; a current of 15 cm/s that reverses at 8 m depth; a front that adds
25 cm/s in 5 s, which no profile foretells; sinking at 0.12 m/s, where each metre of profile lasts longer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.loop import Loop, run_config
from benchmarks.table import Figures, Job, measure
from ltv_mpc.control.controller import Controller
from ltv_mpc.messages import Array
from ltv_mpc.references import Point
from services.run.run_config import RunConfig
from sim.water import WaterColumn

REVERSING_MPS, REVERSES_AT_M = 0.15, 8.0


@dataclass(frozen=True, slots=True)
class Scenario:
    """Scenario: the run configuration of a seed, and the share of thrust that each thruster delivers."""

    run_config: Callable[[tuple[str, ...], int], RunConfig]
    share: Array = field(default_factory=lambda: np.ones(3))


def line(rate_mps: float = 0.2) -> Point:
    """Return the reference down the vertical line through the origin."""
    return Point(north_m=0.0, east_m=0.0, depth_m=40.0, descent_rate_mps=rate_mps, start_s=0.0)


def descent(settings: tuple[str, ...], seed: int) -> RunConfig:
    """Return the paper's descent."""
    return run_config(f"run.seed={seed}", *settings)


def short(settings: tuple[str, ...], seed: int) -> RunConfig:
    """Return the first half of the descent."""
    return descent((*settings, "run.duration_s=100.0"), seed)


def turned(settings: tuple[str, ...], seed: int) -> RunConfig:
    """Return the descent with the bow along the mean current of the first 10 m."""
    north, east = descent(settings, seed).water.over(np.linspace(0.0, 10.0, 11), 0).mean(axis=0)
    start = f"plant.heading_rad={np.arctan2(east, north)}", "plant.north_m=1.0", "run.duration_s=60.0"
    return replace(descent((*settings, *start), seed), reference=line())


def far_off(settings: tuple[str, ...], seed: int) -> RunConfig:
    """Return a descent that starts 5 m off, with another heading for each seed."""
    heading = f"plant.heading_rad={(seed % 8) * 0.7 - 2.8:.1f}"
    start = heading, "plant.north_m=3.0", "plant.east_m=-4.0", "run.duration_s=60.0"
    return replace(descent((*settings, *start), seed), reference=line())


def reversing(settings: tuple[str, ...], seed: int) -> RunConfig:
    """Return a descent through a current that reverses from north to south, added to the seed's profile."""
    s = short(settings, seed)
    depth = s.water.depth_m
    north = np.where(depth <= REVERSES_AT_M, REVERSING_MPS, -REVERSING_MPS)
    added = np.column_stack([north, np.zeros_like(north)])
    return replace(s, water=WaterColumn(depth, s.water.over(depth, 0) + added))


def front(settings: tuple[str, ...], seed: int) -> RunConfig:
    """Return a descent through a front: 25 cm/s within 5 s, at all depths."""
    of_water = "water.feature.kind=front", "water.feature.step_mps=0.25"
    return short((*settings, *of_water, "water.feature.at_s=50.0", "water.feature.width_s=5.0"), seed)


def slow(settings: tuple[str, ...], seed: int) -> RunConfig:
    """Return a descent at 0.12 m/s."""
    return replace(descent(settings, seed), reference=line(0.12))


SCENARIOS = {
    "180 deg off": Scenario(turned),
    "5 m off": Scenario(far_off),
    "half thrust on one side": Scenario(short, np.array([0.5, 1.0, 1.0])),
    "current reverses at a depth": Scenario(reversing),
    "front passes": Scenario(front),
    "sinking at 0.12 m/s": Scenario(slow),
    "descent": Scenario(descent),
}

SETTINGS: dict[str, tuple[str, ...]] = {
    "5.1 s": (),
    "10 s, twice the stages": ("controller.horizon_s=10.0",),
}


def fly(scenario: str, settings: tuple[str, ...], seed: int, kind: type[Controller] = Controller) -> Figures:
    """One run of one scenario."""
    chosen = SCENARIOS[scenario]
    s = chosen.run_config(settings, seed)
    controller = kind(s.vehicle, s.reference, s.scenario.controller)
    return Figures.of(Loop(run_config=s, controller=controller, share=chosen.share).fly())


def one(job: Job) -> Figures:
    """One run."""
    scenario, what = job.row.split(": ")
    return fly(scenario, SETTINGS[what], job.seed)


if __name__ == "__main__":
    measure(__doc__, [f"{scenario}: {what}" for scenario in SCENARIOS for what in SETTINGS], one)
