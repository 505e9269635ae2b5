"""Tables of the newest state, which do not grow: plan, vehicle and fence from above, error ellipse, current."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ltv_mpc.messages import Applied, Array, CurrentProfile, Estimate, FenceInForce, Plan
from ltv_mpc.vehicle.parameters import Vehicle
from services.reporting.plots import fence, vehicle_from_above
from services.reporting.plots.table import Columns, short
from services.reporting.plots.truth import principal

ELLIPSE = 48  # points
SIGMAS = 2.0


def outline(covariance: Array, sigmas: float) -> Array:
    """Return the ellipse (K, 2) of so many standard deviations round the mean of a distribution in the plane."""
    sigma, axes = principal(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE + 1)
    points: Array = sigmas * axes @ (sigma[:, None] * np.array([np.cos(angle), np.sin(angle)]))
    return points.T


class NewestState:
    """Newest estimate, plan, delivered thrusts and fence, and the newest profile of the current."""

    def __init__(self) -> None:
        self.estimate: Estimate | None = None
        self.plan: Plan | None = None
        self.applied: Applied | None = None
        self.profile: CurrentProfile | None = None
        self.fence: FenceInForce | None = None

    def tables(
        self,
        vehicle: Vehicle | None,
        covariance: Array | None,
        seconds: Callable[[int], float],
        heading_deg: Callable[[float], float],
    ) -> dict[str, Columns]:
        """Return the tables; empty ones for what is not known yet.

        Parameters
        ----------
        vehicle : hull and thrust limits.
        covariance : (2, 2) of the plotted position (m^2).
        seconds : converts a vehicle time (ns) to the time axis.
        heading_deg : converts a heading (rad) to the heading axis.
        """
        return {
            **self._of_plan(seconds, heading_deg),
            **vehicle_from_above.tables(self.estimate, self.applied, vehicle, self.profile),
            **fence.tables(self.fence, self.plan),
            "ellipse": self._ellipse(covariance),
            "profile": self._profile(),
        }

    def _of_plan(self, seconds: Callable[[int], float], heading_deg: Callable[[float], float]) -> dict[str, Columns]:
        plan = self.plan
        if plan is None:
            return {"horizon": {}, "ahead": {}, "target": {}}
        horizon: Columns = {
            "north_m": [short(x) for x in plan.states[:, 0]],
            "east_m": [short(x) for x in plan.states[:, 1]],
        }
        ahead: Columns = {"t_s": [short(seconds(t)) for t in plan.t_ns.tolist()]}
        for name, thrust_N in zip(("port_N", "starboard_N", "vertical_N"), plan.thrust_N.T, strict=True):
            ahead[name] = [short(x) for x in thrust_N]
        ahead["heading_deg"] = [short(heading_deg(x)) for x in plan.states[:, 4].tolist()]
        ahead["yaw_rate_dps"] = [short(x) for x in np.degrees(plan.states[:, 5])]
        target: Columns = {}
        if plan.reference_m is not None:
            target = {"north_m": [short(plan.reference_m[0])], "east_m": [short(plan.reference_m[1])]}
        return {"horizon": horizon, "ahead": ahead, "target": target}

    def _ellipse(self, covariance: Array | None) -> Columns:
        """Return the 2-sigma ellipse of the estimated position."""
        if self.estimate is None or covariance is None:
            return {"north_m": [], "east_m": []}
        north, east = outline(covariance, SIGMAS).T
        return {
            "north_m": [short(x + self.estimate.north_m) for x in north],
            "east_m": [short(x + self.estimate.east_m) for x in east],
        }

    def _profile(self) -> Columns:
        """Return the table of the current with its 2-sigma band, one row for each depth."""
        profile = self.profile
        if profile is None:
            return {}
        columns: Columns = {"depth_m": [short(x) for x in profile.depth_m]}
        for name, velocity in (("north", profile.north_mps), ("east", profile.east_mps)):
            columns[f"{name}_mps"] = [short(x) for x in velocity]
            if profile.sd_mps is not None:
                columns[f"{name}_low_mps"] = [short(x) for x in velocity - SIGMAS * profile.sd_mps]
                columns[f"{name}_high_mps"] = [short(x) for x in velocity + SIGMAS * profile.sd_mps]
        return columns
