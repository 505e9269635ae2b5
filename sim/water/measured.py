"""A measured current: a CSV of depths and velocities, held constant above its first and below its last depth."""

from __future__ import annotations

import numpy as np

from ltv_mpc.currents import read_profile
from ltv_mpc.messages import Array


def read(file: str) -> tuple[Array, Array]:
    """The file's depths (K,) and velocities north and east, (K, 2). Raises ``ConfigError``."""
    profile = read_profile(file)
    return profile.depth_m, np.column_stack([profile.north_mps, profile.east_mps])
