"""Vehicle in the view from above: outline of the hull, arrows of its thrusts and of the current at its depth.

Everything is a line in metres, north and east, so that any renderer of plot tables draws it. A thrust at its limit is
as long as the hull; a current of ``CURRENT_MPS`` as well.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.messages import Applied, Array, CurrentProfile, Estimate
from ltv_mpc.vehicle.parameters import Hull, Vehicle
from services.reporting.plots.table import Columns, points

CURRENT_MPS = 0.1
UNKNOWN_HULL = Hull(length_m=2.0, beam_m=0.6)
"""Hull that is drawn if the vehicle file has none."""

OUTLINE = ((0.5, 0.0), (0.25, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.25, -0.5), (0.5, 0.0))
"""Corners of the hull: ahead in lengths, to starboard in beams."""

BARB = 0.25  # of the length of an arrow, at most of the hull


def tables(
    estimate: Estimate | None, applied: Applied | None, vehicle: Vehicle | None, profile: CurrentProfile | None
) -> dict[str, Columns]:
    """Return the tables ``hull``, ``port_arrow``, ``starboard_arrow`` and ``current_arrow``; empty if unknown.

    Parameters
    ----------
    estimate : position and heading of the vehicle.
    applied : delivered thrusts (N).
    vehicle : hull and thrust limits.
    profile : current over depth (m/s).
    """
    shown: dict[str, Columns] = {"hull": {}, "port_arrow": {}, "starboard_arrow": {}, "current_arrow": {}}
    if estimate is None:
        return shown
    hull = (vehicle.hull if vehicle is not None else None) or UNKNOWN_HULL
    corners = np.array(OUTLINE) * (hull.length_m, hull.beam_m)
    shown["hull"] = _placed(corners, estimate)
    if applied is not None and vehicle is not None:
        beside_m = 0.5 * hull.beam_m + 0.1 * hull.length_m
        for name, side, i in (("port_arrow", -1.0, 0), ("starboard_arrow", 1.0, 1)):
            thruster, thrust_N = vehicle.thrusters[i], applied.thrust_N[i]
            limit_N = thruster.max_N if thrust_N > 0.0 else -thruster.min_N
            ahead_m = hull.length_m * thrust_N / limit_N if limit_N > 0.0 else 0.0
            foot = np.array([-0.5 * hull.length_m if ahead_m >= 0.0 else 0.5 * hull.length_m, side * beside_m])
            shown[name] = _placed(_arrow(foot, np.array([ahead_m, 0.0]), hull), estimate)
    if profile is not None:
        velocity = current_at(profile, estimate.depth_m or 0.0)
        arrow = _arrow(np.zeros(2), np.array(velocity) * hull.length_m / CURRENT_MPS, hull)
        shown["current_arrow"] = points(np.add(arrow, [estimate.north_m, estimate.east_m]))
    return shown


def current_at(profile: CurrentProfile, depth_m: float) -> tuple[float, float]:
    """Return the velocity of the water, north and east (m/s), at a depth (m)."""
    return (
        float(np.interp(depth_m, profile.depth_m, profile.north_mps)),
        float(np.interp(depth_m, profile.depth_m, profile.east_mps)),
    )


def _arrow(foot: Array, along: Array, hull: Hull) -> Array:
    """Return a line (5, 2) with an arrow head at ``foot + along``."""
    length_m = math.hypot(*along)
    if length_m == 0.0:
        return np.tile(foot, (5, 1))
    barb = min(BARB * length_m, 0.15 * hull.length_m) * along / length_m
    across = 0.6 * np.array([-barb[1], barb[0]])
    tip = foot + along
    return np.array([foot, tip, tip - barb + across, tip, tip - barb - across])


def _placed(line: Array, estimate: Estimate) -> Columns:
    """Turn a line (K, 2), ahead and to starboard, by the heading and move them to the position."""
    c, s = math.cos(estimate.heading_rad), math.sin(estimate.heading_rad)
    rotation = np.array([[c, -s], [s, c]])
    return points(np.add(line @ rotation.T, [estimate.north_m, estimate.east_m]))
