"""Path geometry: a chain of straight pieces that approximates legs, rounded corners and smooth curves.

A smooth curve is a chain of short pieces, each with its curvature. A corner between two straight legs is rounded by an
arc tangent to both, so that the vehicle need not stop there. With the change of direction phi (rad) at the corner and
the largest distance d of the arc from the corner:

    R = d cos(phi / 2) / (1 - cos(phi / 2)),   tangent length R tan(phi / 2)

The tangent lengths of two corners on a leg are at most the leg, at equal R: points on a circle get its radius. At the
first and the last leg the tangent length is at most half of it. At a corner that cannot be rounded the vehicle stops
and turns on the spot.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.messages import Array

CHORD_RAD = math.radians(4.0)
"""Largest change of direction between two pieces of an arc (rad)."""
SAGITTA_M = 0.01
"""Largest distance of a piece from its arc (m)."""
MIN_RADIUS_M = 0.02
"""Smallest radius of a rounded corner (m). If it would be smaller, the vehicle stops and turns."""
STRAIGHT_RAD = math.radians(1.0)
"""Smallest change of direction at which the vehicle stops and turns (rad)."""
MIN_PIECE_M = 1e-9
"""Points closer than this count as one: two arcs may meet in the middle of a leg."""
MIN_HALF_TURN_RAD, MIN_HALF_TURN_COSINE = 1e-6, 1e-9
"""Bounds of half the change of direction and of its cosine, between which a radius is defined: a straight path needs no
arc, and a reversal has none.
"""
LEAD_IN_M = 0.5
"""Distance from the first point above which the path is preceded by a straight leg to it."""
MAX_POINTS = 100_000
"""Largest number of points of a path."""


class Path(NamedTuple):
    """K points and the K - 1 straight pieces between them."""

    points: Array  # (K, 2) north, east (m)
    depth: Array  # (K,) (m), NaN without a depth
    curvature: Array  # (K-1,) (1/m), 0 on a straight leg
    turn: Array  # (K-1,) (rad) change of direction of the rounded corner that the piece belongs to, + to starboard
    turn_on_spot: Array  # (K,) (rad) change of direction at a point where the vehicle stops and turns, else 0
    speed: Array  # (K-1,) (m/s) wanted
    wait: Array  # (K,) (s) time at rest, besides that of a turn

    @property
    def lengths(self) -> Array:
        """Lengths of the pieces (K-1,) in m."""
        lengths: Array = np.hypot(*np.diff(self.points, axis=0).T)
        return lengths

    @property
    def length_m(self) -> float:
        """Length from the first point to the last (m)."""
        return float(self.lengths.sum())


def smooth_curve(points: Array, depth: Array, curvature: Array, speed_mps: float = math.inf) -> Path:
    """Return the path along a smooth curve.

    Parameters
    ----------
    points : (K, 2) points close together, north and east (m).
    depth : (K,) depth at the points (m), NaN without a depth.
    curvature : (K-1,) curvature of each piece (1/m).
    speed_mps : wanted speed (m/s).
    """
    K = len(points)
    return Path(points, depth, curvature, np.zeros(K - 1), np.zeros(K), np.full(K - 1, speed_mps), np.zeros(K))


def round_corners(
    points: Array, depth: Array, corner_m: float, speed: Array | float = math.inf, wait: Array | float = 0.0
) -> Path:
    """Return the path of straight legs between points, with rounded corners.

    Parameters
    ----------
    points : (K, 2) corners, north and east (m); successive ones differ, or their depths do.
    depth : (K,) depth at the corners (m), NaN without a depth.
    corner_m : largest distance of an arc from its corner (m).
    speed : (K-1,) wanted speed on each leg (m/s).
    wait : (K,) time at rest at each corner (s), which is not rounded then.
    """
    K, legs = len(points), np.diff(points, axis=0)
    speed, wait = np.broadcast_to(speed, K - 1), np.broadcast_to(wait, K)
    lengths = np.hypot(*legs.T)
    course = _courses(legs, lengths)
    turns = np.diff(course)
    turns -= 2.0 * np.pi * np.round(turns / (2.0 * np.pi))
    # Of each point: position, depth, curvature and turn of the piece that leads to it, turn on the spot, speed, wait.
    out = [(points[0], depth[0], 0.0, 0.0, 0.0, 0.0, wait[0])]
    radii = np.where(wait[1:-1] > 0.0, 0.0, _radii(turns, lengths, corner_m)).tolist()
    for k, (turn, R) in enumerate(zip(turns.tolist(), radii, strict=True), start=1):
        if R < MIN_RADIUS_M:
            on_spot = abs(turn) if abs(turn) >= STRAIGHT_RAD else 0.0
            out.append((points[k], depth[k], 0.0, 0.0, on_spot, speed[k - 1], wait[k]))
            continue
        arc, tangent_m = _arc(points[k], course[k - 1], turn, R), R * math.tan(0.5 * abs(turn))
        ends = [depth[k] + (depth[j] - depth[k]) * tangent_m / lengths[leg] for j, leg in ((k - 1, k - 1), (k + 1, k))]
        out.append((arc[0], ends[0], 0.0, 0.0, 0.0, speed[k - 1], 0.0))
        slower = min(speed[k - 1 : k + 1])
        for j, point in enumerate(arc[1:], start=1):
            z = ends[0] + (ends[1] - ends[0]) * j / (len(arc) - 1)
            out.append((point, z, 1.0 / R, turn, 0.0, slower, 0.0))
    out.append((points[-1], depth[-1], 0.0, 0.0, 0.0, speed[-1], wait[-1]))
    p, z, curvature, corner_turn, turn_on_spot, wanted, rest = (np.array(column) for column in zip(*out, strict=True))
    apart = (np.hypot(*np.diff(p, axis=0).T) > MIN_PIECE_M) | (np.abs(np.diff(z)) > MIN_PIECE_M)
    keep = np.concatenate([[True], apart])
    return Path(
        p[keep], z[keep], curvature[keep][1:], corner_turn[keep][1:], turn_on_spot[keep], wanted[keep][1:], rest[keep]
    )


def _courses(legs: Array, lengths: Array) -> Array:
    """Return the course (K-1,) in rad of each leg; a leg without length has that of the one before it."""
    course = np.arctan2(legs[:, 1], legs[:, 0])
    moves = np.append(np.flatnonzero(lengths > MIN_PIECE_M), 0)
    before: Array = course[moves[np.maximum(np.searchsorted(moves[:-1], np.arange(len(legs)), side="right") - 1, 0)]]
    return before


def _radii(turns: Array, lengths: Array, corner_m: float) -> Array:
    """Return the radii R (K-2,) in m of the arcs that round corners; 0 if there is no such arc."""
    half = 0.5 * np.abs(turns)
    exists = (half >= MIN_HALF_TURN_RAD) & (np.cos(half) >= MIN_HALF_TURN_COSINE)
    tangent = np.tan(np.where(exists, half, 0.0))  # over R
    of_leg = np.concatenate([2.0 * tangent[:1], tangent[1:] + tangent[:-1], 2.0 * tangent[-1:]])
    cosine = np.cos(np.where(exists, half, 0.5 * np.pi))
    largest = lengths / np.maximum(of_leg, MIN_HALF_TURN_COSINE) if len(turns) else lengths
    return np.where(exists, np.minimum(corner_m * cosine / (1.0 - cosine), np.minimum(largest[1:], largest[:-1])), 0.0)


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


def with_lead_in(path: Path, start: Array) -> tuple[Path, float]:
    """Return the path preceded by a straight leg from ``start`` to its first point, and the length of that leg (m).

    The vehicle stops and turns between leg and path, unless the path goes straight on (``STRAIGHT_RAD``). If the start
    is nearer than ``LEAD_IN_M``, the path is returned as it is, with length 0.

    Parameters
    ----------
    path : path that follows the leg.
    start : (2,) position north and east (m).
    """
    leg = path.points[0] - start
    length = float(np.hypot(*leg))
    if length < LEAD_IN_M:
        return path, 0.0
    first = first_leg(path)
    turn = abs(math.remainder(math.atan2(first[1], first[0]) - math.atan2(leg[1], leg[0]), 2.0 * math.pi))
    turn_on_spot, zero = path.turn_on_spot.copy(), np.zeros(1)
    turn_on_spot[0] = turn if turn >= STRAIGHT_RAD else 0.0
    ahead = Path(start[None], path.depth[:1], zero, zero, zero, path.speed[:1], zero)
    return Path(*map(np.concatenate, zip(ahead, path._replace(turn_on_spot=turn_on_spot), strict=True))), length


def first_leg(path: Path) -> Array:
    """Return north and east (2,) in m of the first piece that has a length.

    Parameters
    ----------
    path : a path that moves, or only changes its depth.
    """
    leg: Array = np.diff(path.points, axis=0)[int(np.argmax(path.lengths > MIN_PIECE_M))]
    return leg
