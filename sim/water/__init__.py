"""True water of a run: synthetic from a seed or measured, with an optional feature and surface waves."""

from __future__ import annotations

import numpy as np

from ltv_mpc.currents import grid_depths, read_profile
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array
from sim.random_streams import Stream, generator
from sim.scenario import Water
from sim.water import markov
from sim.water.column import WaterColumn
from sim.water.features import Feature
from sim.water.surface_waves import SurfaceWaves

__all__ = ["WaterColumn", "make"]


def make(water: Water, seed: int) -> WaterColumn:
    """Return the column that the settings describe, the same for equal seeds. Raises ``ConfigError``."""
    depth, velocity = _profile(water, seed)
    feature = None if water.feature.kind == "none" else Feature(water)
    waves = SurfaceWaves(water.surface_waves, seed) if water.surface_waves.height_m else None
    change = water.change_mps_per_rts
    return WaterColumn(depth, velocity, change_mps_per_rts=change, seed=seed, feature=feature, waves=waves)


def _profile(water: Water, seed: int) -> tuple[Array, Array]:
    """Return depths (K,) and velocities (K, 2) at t = 0, without the feature."""
    if water.kind == "measured":
        if not water.file:
            raise ConfigError("scenario", "[water] file", 'must name a currents CSV where kind = "measured"')
        profile = read_profile(water.file)
        return profile.depth_m, np.column_stack([profile.north_mps, profile.east_mps])
    depth = grid_depths(water.deepest_m, water.cell_m)
    axes = [
        markov.series(
            generator(seed, stream),
            len(depth),
            sd_mps=water.sd_mps,
            cell_m=water.cell_m,
            correlation_length_m=water.correlation_length_m,
            bound_sd=water.bound_sd,
        )
        for stream in (Stream.WATER_NORTH, Stream.WATER_EAST)
    ]
    return depth, np.column_stack(axes)
