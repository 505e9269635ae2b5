"""Ring of a polygon: the checks that make it simple, and its orientation."""

from __future__ import annotations

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
    crossing = _crossing_edges(vertices)
    if crossing is not None:
        first, second = ((k, (k + 1) % len(vertices)) for k in crossing)
        return (
            f"the ring crosses itself: the edge from vertices[{first[0]}] to vertices[{first[1]}] meets that from "
            f"vertices[{second[0]}] to vertices[{second[1]}]"
        )
    return ""


def signed_area_m2(vertices: Array) -> float:
    """Return the area of a ring (m2): positive if it runs clockwise as seen from above.

    Parameters
    ----------
    vertices : (K, 2) north and east (m).
    """
    n, e = vertices.T
    return 0.5 * float(n @ np.roll(e, -1) - e @ np.roll(n, -1))


def _crossing_edges(vertices: Array) -> tuple[int, int] | None:
    """Return the first pair of edges that meet elsewhere than in the vertex between two neighbours."""
    K = len(vertices)
    begin, end = vertices, np.roll(vertices, -1, axis=0)
    for i in range(K):
        j = np.arange(i + 1, K)
        # the ends of an edge lie on different sides of the other, or on it
        apart = _side(begin[i], end[i], begin[j]) * _side(begin[i], end[i], end[j]) <= 0.0
        apart &= _side(begin[j], end[j], begin[i]) * _side(begin[j], end[j], end[i]) <= 0.0
        low_i, high_i = np.minimum(begin[i], end[i]), np.maximum(begin[i], end[i])
        near = np.all((np.minimum(begin[j], end[j]) <= high_i) & (np.maximum(begin[j], end[j]) >= low_i), axis=1)
        neighbour = (j == i + 1) | (j - i == K - 1)
        # neighbours share a vertex; they overlap if the second turns straight back
        back = (np.abs(_side(begin[i], end[i], np.where((j == i + 1)[:, None], end[j], begin[j]))) == 0.0) & (
            (end[i] - begin[i]) @ (end[j] - begin[j]).T < 0.0
        )
        meets = np.flatnonzero(np.where(neighbour, back, apart & near))
        if len(meets):
            return i, int(j[meets[0]])
    return None


def _side(begin: Array, end: Array, point: Array) -> Array:
    """Return a number whose sign says on which side of the line from begin to end a point is; 0 on it."""
    way, to = end - begin, point - begin
    side: Array = way[..., 0] * to[..., 1] - way[..., 1] * to[..., 0]
    return side
