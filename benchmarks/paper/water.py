"""Currents of Fig 3: synthetic and measured profiles."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.paper.renderer import Run
from ltv_mpc.currents import read_profile
from ltv_mpc.messages import Array
from services.reporting.plots.table import short
from sim.scenario import Water
from sim.water import make

DEEPEST_M = 72.0
"""Depth above which measured profiles are used: the range of descent and ADCP, and a whole cell of the coarsest one."""

FILES = {
    "MORIA-80_ladcp.csv": "LADCP MORIA-80",
    "glider_comet_2016_current_profile.csv": "glider, COMET 2016",
    "kolumbo_dive_a_mean.csv": "Kolumbo, dive a",
    "kolumbo_dive_e_mean.csv": "Kolumbo, dive e",
}
"""Measured profiles by file, with their names."""

SHOWN_SEEDS = 2


class Profile(NamedTuple):
    """Current profile over depth, above ``DEEPEST_M``."""

    name: str
    depth_m: Array  # (K,)
    velocity_mps: Array  # (K, 2), north and east


def synthetic(seed: int) -> Profile:
    """Return the synthetic current of the descent for a seed."""
    profile = make(Water(), seed).profile(0)
    return _above(Profile(f"seed {seed}", profile.depth_m, np.column_stack([profile.north_mps, profile.east_mps])))


def measured(data: Path) -> tuple[list[Profile], list[Path]]:
    """Read the measured profiles in ``data``, and list the missing files. Raises ``ConfigError``."""
    found, missing = [], []
    for file, name in FILES.items():
        path = data / file
        if not path.is_file():
            missing.append(path)
            continue
        profile = read_profile(path)
        velocity = np.column_stack([profile.north_mps, profile.east_mps])
        found.append(_above(Profile(name, profile.depth_m, velocity)))
    return found, missing


def _above(profile: Profile) -> Profile:
    kept = profile.depth_m <= DEEPEST_M
    return profile._replace(depth_m=profile.depth_m[kept], velocity_mps=profile.velocity_mps[kept])


def profile_run(profile: Profile) -> Run:
    """Return a profile in the form that figures draw."""
    north, east = profile.velocity_mps.T
    return Run(
        profile.name,
        {"profile": {"depth_m": _cells(profile.depth_m), "north_mps": _cells(north), "east_mps": _cells(east)}},
    )


def _cells(column: Array) -> list[float | None]:
    return [short(value) for value in column]
