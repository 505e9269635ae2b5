"""A measured current: a CSV of depths and velocities, held constant above its first and below its last depth."""

from __future__ import annotations

import numpy as np

from ltv_mpc.currents import read_profile
from sim.water.column import WaterColumn


def load(file: str, *, change_mps_per_rts: float = 0.0, seed: int = 0) -> WaterColumn:
    """The file's column. Raises ``ConfigError``."""
    profile = read_profile(file)
    velocity = np.column_stack([profile.north_mps, profile.east_mps])
    return WaterColumn(profile.depth_m, velocity, change_mps_per_rts=change_mps_per_rts, seed=seed)
