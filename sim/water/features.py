"""Water features that are added to a column: a front, a step over depth, internal waves, or a tide.

With d = [cos direction, sin direction], north and east, and ramp(x) = x + 1/2 cut to 0 and 1:
front   c(z, t) += step d ramp((t - at_s) / width_s)                all depths at once
step    c(z, t) += step d ramp((z - at_m) / 1 m)                    from its depth down, at all times
waves   c(z, t) += A d cos(pi z / deepest) sin(2 pi t / T)          first mode between surface and ``deepest_m``
tide    c(z, t) += A d sin(2 pi t / T)                              all depths at once
Source  Gill 1982, Atmosphere-Ocean Dynamics, chapter 6: in water of constant stratification the vertical velocity of
        the first mode is proportional to sin(pi z / H), the horizontal one to cos(pi z / H). A vehicle that stays
        within a fraction of a wavelength sees it as a function of depth and time.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.currents import grid_depths
from ltv_mpc.messages import Array
from sim.scenario import Water

STEP_M = 1.0
"""Thickness of the layer over which a step changes the velocity."""


class Feature:
    """Feature of the water, from the settings' table [water.feature]."""

    def __init__(self, water: Water) -> None:
        """Take the settings, whose ``feature.kind`` must not be "none"."""
        self._water, feature = water, water.feature
        self._direction = np.array([math.cos(feature.direction_rad), math.sin(feature.direction_rad)])
        self.steady = feature.kind == "step"

    def depths(self, own_m: Array) -> Array:
        """Return the column's depths (m) together with those at which the feature's slope changes, shape (K,)."""
        water = self._water
        match water.feature.kind:
            case "step":
                at = water.feature.at_m
                return np.union1d(own_m, [at - 0.5 * STEP_M, at + 0.5 * STEP_M])
            case "waves":
                return np.union1d(own_m, grid_depths(water.deepest_m, water.cell_m))
            case _:
                return own_m

    def velocity(self, depth_m: Array, t_s: float) -> Array:
        """Return the added velocity north and east (m/s) at each depth (K,), shape (K, 2)."""
        feature, deepest = self._water.feature, self._water.deepest_m
        match feature.kind:
            case "front":
                passed = min(max((t_s - feature.at_s) / feature.width_s + 0.5, 0.0), 1.0)
                along = np.full(len(depth_m), feature.step_mps * passed)
            case "step":
                along = feature.step_mps * np.clip((depth_m - feature.at_m) / STEP_M + 0.5, 0.0, 1.0)
            case "tide":
                along = np.full(len(depth_m), feature.amplitude_mps * math.sin(2.0 * math.pi * t_s / feature.period_s))
            case _:
                mode = np.cos(math.pi * np.minimum(depth_m, deepest) / deepest)
                along = feature.amplitude_mps * math.sin(2.0 * math.pi * t_s / feature.period_s) * mode
        return np.outer(along, self._direction)
