"""Descents with a hard start: metres off the line, or with the bow away from the current."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.loop import run_config
from ltv_mpc.references import Point
from services.run.run_config import RunConfig


def line(rate_mps: float = 0.2) -> Point:
    """Return the reference down the vertical line through the origin."""
    return Point(north_m=0.0, east_m=0.0, depth_m=40.0, descent_rate_mps=rate_mps, start_s=0.0)


def descent(settings: tuple[str, ...], seed: int) -> RunConfig:
    """Return the paper's descent."""
    return run_config(f"run.seed={seed}", *settings)


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
