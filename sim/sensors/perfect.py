"""Perfect estimate: the true state in place of an estimator, for runs in which localisation is not the question."""

from __future__ import annotations

import numpy as np

from ltv_mpc.currents import grid_depths
from ltv_mpc.frames import roll_pitch_heading
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.messages import CurrentProfile, Estimate
from sim.sensors.vehicle_state import VehicleState
from sim.water import WaterColumn


class PerfectState:
    """State without error, and the true current at the estimator's grid points with a standard deviation of 0."""

    def __init__(self, settings: EstimatorConfig, water: WaterColumn, bottom_m: float | None) -> None:
        """``bottom_m`` is the depth of the sea bed; None: out of reach."""
        self._water, self._bottom_m = water, bottom_m
        self._depth = grid_depths(settings.deepest_m, settings.cell_m)

    def sample(self, now: VehicleState) -> list[Estimate]:
        """Return the true state now."""
        current = self._water.over(self._depth, now.t_ns)
        altitude_m = None if self._bottom_m is None else max(self._bottom_m - now.position_m[2], 0.0)
        return [
            Estimate(
                t_ns=now.t_ns,
                north_m=now.position_m[0],
                east_m=now.position_m[1],
                heading_rad=roll_pitch_heading(now.rotation)[2],
                yaw_rate_radps=now.heading_rate_radps,
                velocity_north_mps=now.velocity_mps[0],
                velocity_east_mps=now.velocity_mps[1],
                depth_m=now.position_m[2],
                velocity_down_mps=now.velocity_mps[2],
                altitude_m=altitude_m,
                current=CurrentProfile(
                    depth_m=self._depth,
                    north_mps=np.ascontiguousarray(current[:, 0]),
                    east_mps=np.ascontiguousarray(current[:, 1]),
                    sd_mps=np.zeros_like(self._depth),
                ),
            )
        ]
