"""Path geometry: straight legs, rounded corners and smooth curves, as a chain of straight pieces between points.

A smooth curve is a chain of short pieces, each with its curvature. A corner between two straight legs is rounded by an
arc tangent to both, so that the vehicle need not stop there:

    R = d cos(phi / 2) / (1 - cos(phi / 2)),   tangent length R tan(phi / 2)

for a corner of angle phi (rad, 0 is straight on) whose arc deviates from it by at most d; short legs get a smaller R.
At a corner that cannot be rounded the vehicle stops and turns.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.messages import Array

CHORD_RAD = math.radians(4.0)
"""Largest change of direction between two pieces of an arc."""
SAGITTA_M = 0.01
"""Largest distance of a piece from its arc."""
MIN_RADIUS_M = 0.02
"""Smallest radius of a rounded corner; at a sharper one the vehicle stops."""
STRAIGHT_RAD = math.radians(1.0)
"""Smallest change of direction that counts as a corner."""
MAX_POINTS = 100_000


class Path(NamedTuple):
    """K points and the K - 1 pieces between them."""

    points: Array  # (K, 2) north, east (m)
    depth: Array  # (K,) m, NaN without a depth
    curvature: Array  # (K-1,) 1/m, 0 on a straight piece
    turn: Array  # (K-1,) rad, total angle of the rounded corner that the piece belongs to, else 0
    stop: Array  # (K,) rad, angle of the turn on the spot at that point, 0 if the path continues without a stop

    @property
    def lengths(self) -> Array:
        """Lengths of the pieces (K-1,) in m."""
        lengths: Array = np.hypot(*np.diff(self.points, axis=0).T)
        return lengths

    @property
    def length_m(self) -> float:
        """Length from the first point to the last (m)."""
        return float(self.lengths.sum())


def smooth_curve(points: Array, curvature: Array) -> Path:
    """Return the path along a smooth curve.

    Parameters
    ----------
    points : (K, 2) points close together, north and east (m).
    curvature : (K-1,) curvature of each piece (1/m).
    """
    K = len(points)
    return Path(points, np.full(K, np.nan), curvature, np.zeros(K - 1), np.zeros(K))


def round_corners(points: Array, depth: Array, corner_m: float) -> Path:
    """Return the path of straight legs between points, with rounded corners.

    Parameters
    ----------
    points : (K, 2) corners, north and east (m); successive ones differ.
    depth : (K,) depth at the corners (m), NaN without a depth.
    corner_m : largest deviation of an arc from its corner (m).
    """
    legs = np.diff(points, axis=0)
    lengths = np.hypot(*legs.T)
    course = np.arctan2(legs[:, 1], legs[:, 0])
    turns = np.diff(course)
    turns -= 2.0 * np.pi * np.round(turns / (2.0 * np.pi))
    out = [(points[0], depth[0], 0.0, 0.0, 0.0)]  # point, depth, curvature and turn of the piece before it, stop
    for k, signed in enumerate(turns, start=1):
        turn = abs(float(signed))
        room = 0.5 * min(lengths[k - 1], lengths[k])
        R = _radius(turn, corner_m, room)
        if turn < STRAIGHT_RAD or R < MIN_RADIUS_M:
            out.append((points[k], depth[k], 0.0, 0.0, turn if turn >= STRAIGHT_RAD else 0.0))
            continue
        for j, point in enumerate(_arc(points[k], course[k - 1], float(signed), R)):
            out.append((point, depth[k], 1.0 / R if j else 0.0, turn if j else 0.0, 0.0))
    out.append((points[-1], depth[-1], 0.0, 0.0, 0.0))
    p, z, curvature, turn_, stop = (np.array(column) for column in zip(*out, strict=True))
    keep = np.concatenate([[True], np.hypot(*np.diff(p, axis=0).T) > 1e-9])  # two arcs may meet in the middle of a leg
    return Path(p[keep], z[keep], curvature[keep][1:], turn_[keep][1:], stop[keep])


def _radius(turn: float, corner_m: float, room: float) -> float:
    """Return the radius R (m) of the arc that rounds a corner."""
    half = 0.5 * turn
    if half < 1e-6 or math.cos(half) < 1e-9:
        return 0.0
    return min(corner_m * math.cos(half) / (1.0 - math.cos(half)), room / math.tan(half))


def _arc(corner: Array, course: float, turn: float, R: float) -> Array:
    """Return points of the arc of radius R at a corner, from a course (rad) to course + turn, both ends included."""
    sign = math.copysign(1.0, turn)
    first = corner - R * math.tan(0.5 * abs(turn)) * np.array([math.cos(course), math.sin(course)])
    centre = first + sign * R * np.array([-math.sin(course), math.cos(course)])
    at = course + turn * np.linspace(0.0, 1.0, chord_count(abs(turn), R) + 1)
    return centre + sign * R * np.stack([np.sin(at), -np.cos(at)], axis=1)


def chord_count(turn: float, R: float) -> int:
    """Return the number of straight pieces that approximate an arc.

    Parameters
    ----------
    turn : angle of the arc (rad), >= 0.
    R : radius (m).
    """
    step = min(CHORD_RAD, 2.0 * math.acos(max(1.0 - SAGITTA_M / R, 0.0))) if R > 0.0 else CHORD_RAD
    return max(1, math.ceil(turn / step))


def with_lead_in(path: Path, start: Array, shortest_m: float) -> tuple[Path, float]:
    """Return the path preceded by a straight leg from ``start`` to its first point, and the length of that leg (m).

    The vehicle stops at the corner between leg and path.

    Parameters
    ----------
    path : the path.
    start : (2,) position north and east (m).
    shortest_m : a leg shorter than this is omitted (m).
    """
    way = path.points[0] - start
    length = float(np.hypot(*way))
    if length < shortest_m:
        return path, 0.0
    first = path.points[1] - path.points[0]
    turn = abs(math.remainder(math.atan2(first[1], first[0]) - math.atan2(way[1], way[0]), 2.0 * math.pi))
    stop = path.stop.copy()
    stop[0] = turn if turn >= STRAIGHT_RAD else 0.0
    return (
        Path(
            np.concatenate([start[None], path.points]),
            np.concatenate([path.depth[:1], path.depth]),
            np.concatenate([[0.0], path.curvature]),
            np.concatenate([[0.0], path.turn]),
            np.concatenate([[0.0], stop]),
        ),
        length,
    )
