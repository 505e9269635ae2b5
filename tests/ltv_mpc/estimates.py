"""Estimates of vehicles that move, and the water around them."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from ltv_mpc.messages import CurrentProfile, Estimate, Pair


def water(north_mps: float = 0.0, east_mps: float = 0.0) -> CurrentProfile:
    """Return a current that is the same at all depths."""
    return CurrentProfile(depth_m=np.zeros(1), north_mps=np.array([north_mps]), east_mps=np.array([east_mps]))


def moving(velocity_mps: Pair = (0.0, 0.0), **fields: Any) -> Estimate:
    """Return the estimate of a vehicle with a velocity over ground, north and east; ``fields`` replaces others."""
    north_mps, east_mps = velocity_mps
    return msgspec.structs.replace(
        Estimate.at_rest(), velocity_north_mps=north_mps, velocity_east_mps=east_mps, **fields
    )
