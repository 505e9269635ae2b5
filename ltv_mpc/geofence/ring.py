"""Ring of a polygon: the checks that make it simple, and its orientation."""

from __future__ import annotations

import re

import numpy as np

from ltv_mpc.messages import Array

MIN_LENGTH_M = 1e-3
"""Shortest edge of a ring."""


def ring_problem(vertices: Array) -> str:
    """Return what is wrong with a ring as text; empty for a simple polygon.

    Parameters
    ----------
    vertices : (K, 2) north and east (m) of K >= 3 vertices; the last edge leads back to the first.
    """
    edges = np.roll(vertices, -1, axis=0) - vertices
    short = np.flatnonzero(np.hypot(*edges.T) < MIN_LENGTH_M)
    if len(short):
        after = (int(short[0]) + 1) % len(vertices)
        return f"vertices[{short[0]}] and vertices[{after}] are the same position"
    import shapely  # takes a tenth of a second, and only a fence needs it

    polygon = shapely.Polygon(vertices)
    if polygon.is_valid:
        return ""
    place = shapely.Point(*map(float, re.findall(r"[-+.\de]+(?=[ \]])", shapely.is_valid_reason(polygon))))
    lines = shapely.linestrings(np.stack([vertices, vertices + edges], axis=1))
    first, second = sorted(np.argsort(shapely.distance(lines, place), kind="stable")[:2].tolist())
    ends = [f"from vertices[{k}] to vertices[{(k + 1) % len(vertices)}]" for k in (first, second)]
    return f"the ring crosses itself: the edge {ends[0]} meets that {ends[1]}"


def signed_area_m2(vertices: Array) -> float:
    """Return the area of a ring (m2): positive if it runs clockwise as seen from above.

    Parameters
    ----------
    vertices : (K, 2) north and east (m).
    """
    n, e = vertices.T
    return 0.5 * float(n @ np.roll(e, -1) - e @ np.roll(n, -1))
