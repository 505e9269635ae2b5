"""Measured current: a CSV of depths and velocities, constant above its first and below its last depth."""

from __future__ import annotations

import numpy as np

from ltv_mpc.currents import read_profile
from ltv_mpc.messages import Array


def read(file: str) -> tuple[Array, Array]:
    """Return the file's depths (m), (K,), and velocities north and east (m/s), (K, 2). Raises ``ConfigError``."""
    profile = read_profile(file)
    return profile.depth_m, np.column_stack([profile.north_mps, profile.east_mps])
