"""Fence and obstacles in the view from above: boundaries, and the lines that the centre of the vehicle may not cross.

The line of a zone is its boundary grown by hull and stated margin: the message does not have the clearance in force,
which is larger where 3 standard deviations of the position are more than the margin. An obstacle has two such lines,
at both ends of the plan. They are grown by 3 standard deviations of its predicted position too. Everything is a line
in metres, north and east; None separates two lines.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.geofence.obstacles import OBSTACLE_MARGIN, predicted_m, required_m
from ltv_mpc.messages import Array, FenceInForce, Obstacle, Plan, ZoneInForce
from services.reporting.plots.table import Cell, Columns, short

CIRCLE = 48  # points


def tables(fence: FenceInForce | None, plan: Plan | None) -> dict[str, Columns]:
    """Return the tables of zones and obstacles, and of the lines around them; empty if unknown.

    ``bounding`` has those lines of ``kept_free`` and ``obstacles_kept_free`` that bound the newest plan.

    Parameters
    ----------
    fence : zones and obstacles in force.
    plan : the newest one; obstacles are drawn where they are predicted at its first knot, with their way to its last.
    """
    zones: list[Array] = []
    kept_free: list[Array] = []
    bounding: list[Array] = []
    obstacles: list[Array] = []
    around_obstacles: list[Array] = []
    paths: list[Array] = []
    report = None if plan is None else plan.fence
    active = () if report is None else report.active
    hull_m = 0.0 if fence is None else fence.hull_radius_m
    for zone in () if fence is None else fence.zones:
        distance_m = hull_m + zone.margin_m
        outwards = -distance_m if zone.keep_in else distance_m
        disc = zone.radius_m > 0.0
        zones.append(boundary(zone))
        free = _circle(zone.vertices_m[0], zone.radius_m + distance_m) if disc else _grown(zone.vertices_m, outwards)
        (bounding if zone.label in active else kept_free).append(free)
    ends_ns = [] if plan is None else plan.t_ns[[0, -1]].tolist()
    for obstacle in fence.obstacles if fence is not None and ends_ns else ():
        way = np.array([predicted_m(obstacle, t_ns) for t_ns in ends_ns])
        obstacles.append(_circle(way[0], obstacle.radius_m))
        paths.append(way)
        lines = bounding if f"obstacle {obstacle.id}" in active else around_obstacles
        for centre, t_ns in zip(way, ends_ns, strict=True):
            lines.append(_circle(centre, _kept_free_m(obstacle, ends_ns[0], t_ns, hull_m)))
    return {
        name: _lines(parts)
        for name, parts in (
            ("zones", zones),
            ("kept_free", kept_free),
            ("bounding", bounding),
            ("obstacles", obstacles),
            ("obstacles_kept_free", around_obstacles),
            ("obstacle_paths", paths),
        )
    }


def boundary(zone: ZoneInForce) -> Array:
    """Return the closed boundary (K, 2) of a zone, north and east (m)."""
    return _circle(zone.vertices_m[0], zone.radius_m) if zone.radius_m > 0.0 else _closed(zone.vertices_m)


def _kept_free_m(obstacle: Obstacle, start_ns: int, t_ns: int, hull_m: float) -> float:
    """Return how far from an obstacle the centre of the vehicle stays at a time of a plan (m)."""
    age_s = (max(start_ns - obstacle.t_ns, 0) + t_ns - start_ns) * 1e-9
    return required_m(obstacle, age_s, (1.0 + OBSTACLE_MARGIN) * hull_m)


def _closed(ring: Array) -> Array:
    return np.vstack([ring, ring[:1]])


def _circle(centre: Array, radius_m: float) -> Array:
    angle = np.linspace(0.0, 2.0 * np.pi, CIRCLE + 1)
    circle: Array = centre + radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
    return circle


def _grown(ring: Array, outwards_m: float) -> Array:
    """Return a ring whose edges are moved outwards, with an arc round each corner that points to that side.

    At other corners the moved edges meet; beside edges that are shorter than the distance the line is not exact.
    """
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    area = np.sum(ring[:, 0] * np.roll(ring[:, 1], -1) - np.roll(ring[:, 0], -1) * ring[:, 1])
    normals = np.column_stack([after[:, 1], -after[:, 0]]) * (1.0 if area > 0.0 else -1.0)
    normals /= np.hypot(*normals.T)[:, None]
    points: list[Array] = []
    for k in range(len(ring)):
        first, last = np.arctan2(*normals[k - 1][::-1]), np.arctan2(*normals[k][::-1])
        turn = np.remainder(last - first + np.pi, 2.0 * np.pi) - np.pi
        outer = (before[k, 0] * after[k, 1] - before[k, 1] * after[k, 0]) * area * outwards_m > 0.0
        if outer:
            angle = np.linspace(first, first + turn, 9)
            points.append(ring[k] + outwards_m * np.column_stack([np.cos(angle), np.sin(angle)]))
        else:
            both = normals[k - 1] + normals[k]
            points.append(ring[k : k + 1] + outwards_m * both / (1.0 + normals[k - 1] @ normals[k]))
    return _closed(np.vstack(points))


def _lines(parts: list[Array]) -> Columns:
    """Return all lines in one table."""
    north: list[Cell] = []
    east: list[Cell] = []
    for part in parts:
        north += [*(short(x) for x in part[:, 0]), None]
        east += [*(short(x) for x in part[:, 1]), None]
    return {"north_m": north[:-1], "east_m": east[:-1]}
