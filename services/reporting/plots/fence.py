"""Fence and obstacles in the view from above: boundaries, and the lines that the centre of the vehicle may not cross.

The line of a zone is its boundary grown by hull and stated margin: the message does not have the clearance in force,
which is larger where 3 standard deviations of the position are more than the margin. An obstacle has two such lines,
at both ends of the plan. They are grown by 3 standard deviations of its predicted position too. Everything is a line
in metres, north and east; None separates two lines.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.geofence.obstacles import OBSTACLE_MARGIN, predicted_m, required_m
from ltv_mpc.messages import Array, FenceInForce, Plan, ZoneInForce
from services.reporting.plots.table import Columns, points
from services.reporting.plots.truth import outline

NAMES = ("zones", "kept_free", "bounding", "obstacles", "obstacles_kept_free", "obstacle_paths")


def tables(fence: FenceInForce | None, plan: Plan | None) -> dict[str, Columns]:
    """Return the tables of zones and obstacles, and of the lines around them; empty if unknown.

    ``bounding`` has those lines of ``kept_free`` and ``obstacles_kept_free`` that bound the newest plan.

    Parameters
    ----------
    fence : zones and obstacles in force.
    plan : the newest one; obstacles are drawn where they are predicted at its first knot, with their way to its last.
    """
    lines: dict[str, list[Array]] = {name: [] for name in NAMES}
    active = () if plan is None or plan.fence is None else plan.fence.active
    if fence is not None:
        for zone in fence.zones:
            lines["zones"].append(boundary(zone))
            around = lines["bounding" if zone.label in active else "kept_free"]
            around += kept_free(zone, fence.hull_radius_m + zone.margin_m)
    if fence is not None and plan is not None:
        ends_ns = plan.t_ns[[0, -1]].tolist()
        for obstacle in fence.obstacles:
            way = np.array([predicted_m(obstacle, t_ns) for t_ns in ends_ns])
            lines["obstacles"].append(_circle(way[0], obstacle.radius_m))
            lines["obstacle_paths"].append(way)
            around = lines["bounding" if f"obstacle {obstacle.id}" in active else "obstacles_kept_free"]
            for centre, t_ns in zip(way, ends_ns, strict=True):
                age_s = (max(ends_ns[0] - obstacle.t_ns, 0) + t_ns - ends_ns[0]) * 1e-9
                need_m = required_m(obstacle, age_s, (1.0 + OBSTACLE_MARGIN) * fence.hull_radius_m)
                around.append(_circle(centre, need_m))
    return {name: points(*parts) for name, parts in lines.items()}


def boundary(zone: ZoneInForce) -> Array:
    """Return the closed boundary (K, 2) of a zone, north and east (m)."""
    if zone.radius_m > 0.0:
        return _circle(zone.vertices_m[0], zone.radius_m)
    return np.vstack([zone.vertices_m, zone.vertices_m[:1]])


def kept_free(zone: ZoneInForce, distance_m: float) -> list[Array]:
    """Return the lines (K, 2) at a distance (m) from a zone, on the side where the vehicle may be."""
    if zone.radius_m > 0.0:
        return [_circle(zone.vertices_m[0], zone.radius_m + distance_m)]
    import shapely  # takes a twentieth of a second, and only a fence needs it

    shape = shapely.Polygon if len(zone.vertices_m) > 2 else shapely.MultiPoint  # any publisher may give fewer
    grown = shape(zone.vertices_m).buffer(-distance_m if zone.keep_in else distance_m, quad_segs=8)
    return [shapely.get_coordinates(part.exterior) for part in shapely.get_parts(grown) if not part.is_empty]


def _circle(centre: Array, radius_m: float) -> Array:
    return np.add(centre, outline(np.eye(2), radius_m))
