"""Tables of the newest state, which do not grow: plan, vehicle and fence from above, error ellipse, current."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ltv_mpc.messages import Applied, Array, CurrentProfile, Estimate, FenceInForce, Plan
from ltv_mpc.vehicle.parameters import Vehicle
from services.reporting.plots import fence, vehicle_from_above
from services.reporting.plots.table import Columns, points, shorts
from services.reporting.plots.truth import outline

SIGMAS = 2.0


def tables(
    newest: Mapping[type, Any],
    vehicle: Vehicle | None,
    covariance: Array | None,
    seconds: Callable[[int], float],
    heading_deg: Callable[[float], float],
) -> dict[str, Columns]:
    """Return the tables; empty ones for what is not known yet.

    Parameters
    ----------
    newest : newest message of each type, and the newest profile of the current.
    vehicle : hull and thrust limits.
    covariance : (2, 2) of the plotted position (m^2).
    seconds : converts a vehicle time (ns) to the time axis.
    heading_deg : converts a heading (rad) to the heading axis.
    """
    estimate, plan, profile = newest.get(Estimate), newest.get(Plan), newest.get(CurrentProfile)
    ellipse = points()
    if estimate is not None and covariance is not None:
        ellipse = points(np.add(outline(covariance, SIGMAS), [estimate.north_m, estimate.east_m]))
    return {
        **_of_plan(plan, seconds, heading_deg),
        **vehicle_from_above.tables(estimate, newest.get(Applied), vehicle, profile),
        **fence.tables(newest.get(FenceInForce), plan),
        "ellipse": ellipse,
        "profile": profile_table(profile),
    }


def _of_plan(
    plan: Plan | None, seconds: Callable[[int], float], heading_deg: Callable[[float], float]
) -> dict[str, Columns]:
    if plan is None:
        return {"horizon": {}, "ahead": {}, "target": {}}
    ahead: Columns = {"t_s": shorts(map(seconds, plan.t_ns.tolist()))}
    for name, thrust_N in zip(("port_N", "starboard_N", "vertical_N"), plan.thrust_N.T, strict=True):
        ahead[name] = shorts(thrust_N)
    ahead["heading_deg"] = shorts(map(heading_deg, plan.states[:, 4].tolist()))
    ahead["yaw_rate_dps"] = shorts(np.degrees(plan.states[:, 5]))
    target = points() if plan.reference_m is None else points(np.array([plan.reference_m]))
    return {"horizon": points(plan.states[:, :2]), "ahead": ahead, "target": target}


def profile_table(profile: CurrentProfile | None) -> Columns:
    """Return the table of the current with its 2-sigma band, one row for each depth; empty if it is not known."""
    if profile is None:
        return {}
    columns: Columns = {"depth_m": shorts(profile.depth_m)}
    for name, velocity in (("north", profile.north_mps), ("east", profile.east_mps)):
        columns[f"{name}_mps"] = shorts(velocity)
        if profile.sd_mps is not None:
            columns[f"{name}_low_mps"] = shorts(velocity - SIGMAS * profile.sd_mps)
            columns[f"{name}_high_mps"] = shorts(velocity + SIGMAS * profile.sd_mps)
    return columns
