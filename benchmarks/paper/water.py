"""Currents of Fig 3: synthetic profiles, measured profiles, and their structure functions.

Structure function of one axis, D(h) = mean over z of (c(z + h) - c(z))^2, here the mean of north and east. Of the
first-order Gauss-Markov process D(h) = 2 sd^2 (1 - exp(-h / L)), from which the bound of 3 sd takes 2 to 4 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.paper.renderer import Run
from benchmarks.paper.structure import LAG, MEAN_SQUARE, SYNTHETIC
from ltv_mpc.currents import read_profile
from ltv_mpc.messages import Array
from services.reporting.plots.table import Columns, short
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
SEEDS = 200
"""Number of seeds of the band."""

LEAST_PAIRS = 4
"""Smallest number of differences with a meaningful mean square."""


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


def structure(profile: Profile, cell_m: float = 1.0) -> tuple[Array, Array]:
    """Compute lags h (J,) in whole cells up to half of the profile, and D(h) (J,) of one axis (m^2/s^2).

    A pair counts for the lag that its difference in depth is nearest to.
    """
    depth, c = profile.depth_m, profile.velocity_mps
    i, j = np.triu_indices(len(depth), k=1)
    lag = np.rint((depth[j] - depth[i]) / cell_m).astype(int)
    square = np.mean((c[j] - c[i]) ** 2, axis=1)
    pairs = np.bincount(lag)
    enough = np.flatnonzero(pairs >= LEAST_PAIRS)
    enough = enough[(enough > 0) & (enough * cell_m <= (depth[-1] - depth[0]) / 2)]
    return enough * cell_m, np.bincount(lag, weights=square)[enough] / pairs[enough]


def model(lag_m: Array) -> Array:
    """Return D(h) of the process from which the synthetic profiles are drawn, without its bound."""
    water = Water()
    return -2.0 * water.sd_mps**2 * np.expm1(-lag_m / water.correlation_length_m)


def profile_run(profile: Profile) -> Run:
    """Return a profile in the form that figures draw."""
    north, east = profile.velocity_mps.T
    return Run(
        profile.name,
        {"profile": {"depth_m": _cells(profile.depth_m), "north_mps": _cells(north), "east_mps": _cells(east)}},
    )


def structure_run(drawn_up: Sequence[Profile], profiles: Sequence[Profile]) -> Run:
    """Return the tables of the structure functions: the band of the synthetic profiles, and each of ``profiles``."""
    drawn = [structure(one) for one in drawn_up]
    lag = drawn[0][0]
    low, high = np.quantile([D for _, D in drawn], [0.05, 0.95], axis=0)
    tables: dict[str, Columns] = {
        SYNTHETIC: {
            LAG: lag.tolist(),
            "low_m2ps2": low.tolist(),
            "high_m2ps2": high.tolist(),
            "model_m2ps2": model(lag).tolist(),
        }
    }
    for profile in profiles:
        at, D = structure(profile)
        tables[profile.name] = {LAG: at.tolist(), MEAN_SQUARE: D.tolist()}
    return Run("structure", tables)


def _cells(column: Array) -> list[float | None]:
    return [short(value) for value in column]
