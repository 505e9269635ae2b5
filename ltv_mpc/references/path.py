"""The geometry of a path: straight legs, rounded corners, bends.

A path is a chain of straight pieces between points. A bend is a chain of short ones, each with its curvature; a corner
between two straight legs is rounded by an arc that touches both, so that nobody has to stop there:

    R = d cos(phi / 2) / (1 - cos(phi / 2)),   tangent length R tan(phi / 2)

for a corner of angle phi (rad, 0 is straight on) that is cut by at most d; shorter legs get a smaller R. A corner that
cannot be rounded is a point at which to stop and turn.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.messages import Array

CHORD_RAD = math.radians(4.0)
"""Of an arc of the path: largest change of direction between two pieces."""
SAGITTA_M = 0.01
"""And how far a piece may lie off its arc."""
SMALLEST_RADIUS_M = 0.02
"""A corner that would be rounded by less is one to stop at."""
STRAIGHT_RAD = math.radians(1.0)
"""A smaller change of direction is no corner."""
MOST_POINTS = 100_000


class Path(NamedTuple):
    """K points and K - 1 pieces between them."""

    points: Array  # (K, 2) north, east (m)
    depth: Array  # (K,) m, NaN where none is wanted
    curvature: Array  # (K-1,) 1/m, 0 on a straight piece
    turn: Array  # (K-1,) rad, the whole angle of the rounded corner that the piece belongs to, else 0
    stop: Array  # (K,) rad, by how much to turn on the spot at that point, 0 where the path goes on

    @property
    def lengths(self) -> Array:
        """(K-1,) m."""
        lengths: Array = np.hypot(*np.diff(self.points, axis=0).T)
        return lengths

    @property
    def length_m(self) -> float:
        """From the first point to the last."""
        return float(self.lengths.sum())


def bend(points: Array, curvature: Array) -> Path:
    """A smooth curve through points (K, 2) that lie close together, with the curvature (K-1,) of each piece."""
    K = len(points)
    return Path(points, np.full(K, np.nan), curvature, np.zeros(K - 1), np.zeros(K))


def rounded(points: Array, depth: Array, corner_m: float) -> Path:
    """Straight legs between points (K, 2), no two alike in a row; each corner is cut by at most ``corner_m``."""
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
        if turn < STRAIGHT_RAD or R < SMALLEST_RADIUS_M:
            out.append((points[k], depth[k], 0.0, 0.0, turn if turn >= STRAIGHT_RAD else 0.0))
            continue
        for j, point in enumerate(_arc(points[k], course[k - 1], float(signed), R)):
            out.append((point, depth[k], 1.0 / R if j else 0.0, turn if j else 0.0, 0.0))
    out.append((points[-1], depth[-1], 0.0, 0.0, 0.0))
    p, z, curvature, turn_, stop = (np.array(column) for column in zip(*out, strict=True))
    keep = np.concatenate([[True], np.hypot(*np.diff(p, axis=0).T) > 1e-9])  # two arcs may meet in the middle of a leg
    return Path(p[keep], z[keep], curvature[keep][1:], turn_[keep][1:], stop[keep])


def _radius(turn: float, corner_m: float, room: float) -> float:
    """R of the arc that rounds a corner."""
    half = 0.5 * turn
    if half < 1e-6 or math.cos(half) < 1e-9:
        return 0.0
    return min(corner_m * math.cos(half) / (1.0 - math.cos(half)), room / math.tan(half))


def _arc(corner: Array, course: float, turn: float, R: float) -> Array:
    """Points of the arc of radius R about a corner, from a course (rad) to course + turn, both ends included."""
    sign = math.copysign(1.0, turn)
    first = corner - R * math.tan(0.5 * abs(turn)) * np.array([math.cos(course), math.sin(course)])
    centre = first + sign * R * np.array([-math.sin(course), math.cos(course)])
    at = course + turn * np.linspace(0.0, 1.0, pieces(abs(turn), R) + 1)
    return centre + sign * R * np.stack([np.sin(at), -np.cos(at)], axis=1)


def pieces(turn: float, R: float) -> int:
    """Into how many straight pieces an arc of ``turn`` rad is cut."""
    step = min(CHORD_RAD, 2.0 * math.acos(max(1.0 - SAGITTA_M / R, 0.0))) if R > 0.0 else CHORD_RAD
    return max(1, math.ceil(turn / step))


def with_lead_in(path: Path, start: Array, shortest_m: float) -> tuple[Path, float]:
    """The path with a straight leg from ``start`` (2,) to its first point, and the length of what was added.

    A leg shorter than ``shortest_m`` is left out. The corner between leg and path is one to stop at.
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
