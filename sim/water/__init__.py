"""The true water: seeded and synthetic, or measured."""

from __future__ import annotations

import numpy as np

from ltv_mpc.errors import ConfigError
from sim.draws import Stream, generator
from sim.scenario import Water
from sim.water import markov, measured
from sim.water.column import WaterColumn

__all__ = ["WaterColumn", "make"]


def make(water: Water, seed: int) -> WaterColumn:
    """The column that ``water`` describes; the same for all who ask with the same seed. Raises ``ConfigError``."""
    if water.kind == "measured":
        if not water.file:
            raise ConfigError("scenario", "[water] file", 'must name a currents CSV where kind = "measured"')
        return measured.load(water.file, change_mps_per_rts=water.change_mps_per_rts, seed=seed)
    depth = markov.depths(water.deepest_m, water.cell_m)
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
    return WaterColumn(depth, np.column_stack(axes), change_mps_per_rts=water.change_mps_per_rts, seed=seed)
