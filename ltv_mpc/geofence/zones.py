"""Zones for compiled code: arrays of fixed size, and the signed distance to a zone.

Every zone is a ring of vertices with a radius around it; a disc is one vertex with its radius. Rings are oriented so
that the allowed side is to starboard of every edge: keep-in rings run clockwise as seen from above, keep-out rings
counter-clockwise. With the nearest point q of the ring and the outward normal m there, the clearance of a point p is

    d(p) = +-|p - q| - radius          positive on the allowed side

The side is that of the nearest edge. At a vertex it is that of the sum of both normals (Baerentzen & Aanaes 2005).
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from ltv_mpc.geofence.fence import Fence
from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array, FenceInForce

Nearest: TypeAlias = tuple[float, float, float, float, float]


class Zones(NamedTuple):
    """Zones of a fence; those of one zone are ``vertices[first[z]:first[z + 1]]``."""

    vertices: Array  # (V, 2) north and east (m)
    first: npt.NDArray[np.int64]  # (Z+1,)
    radius: Array  # (Z,) around the vertices (m)
    margin: Array  # (Z,) (m)
    circle: Array  # (Z, 3) north, east and radius of a circle around the forbidden side (m); infinite for keep-in


def pack_zones(fence: Fence | FenceInForce) -> Zones:
    """Return the zones of a fence in their order.

    Parameters
    ----------
    fence : has at least one zone.
    """
    rings, first, radii, margins, circles = [], [0], [], [], []
    for zone in fence.zones if isinstance(fence, FenceInForce) else fence.zones():
        ring = zone.vertices_m
        north, east = ring.T
        runs_clockwise = north @ np.roll(east, -1) > east @ np.roll(north, -1)
        if runs_clockwise != zone.keep_in:
            ring = ring[::-1]
        centre = 0.5 * (ring.min(axis=0) + ring.max(axis=0))
        around = np.inf if zone.keep_in else zone.radius_m + np.hypot(*(ring - centre).T).max()
        rings.append(ring)
        first.append(first[-1] + len(ring))
        radii.append(zone.radius_m)
        margins.append(zone.margin_m)
        circles.append([*centre, around])
    return Zones(np.concatenate(rings), np.array(first), np.array(radii), np.array(margins), np.array(circles))


@jit_outlined
def nearest(zones: Zones, z: int, north: float, east: float) -> Nearest:
    """Return the clearance of a point from one zone (m), the outward normal and the nearest point of the boundary.

    Parameters
    ----------
    zones : zones of the fence.
    z : number of the zone.
    north, east : point (m).

    Returns
    -------
    Clearance (m), positive on the allowed side; normal north, east; boundary north, east (m).
    """
    begin, end = zones.first[z], zones.first[z + 1]
    best, of_edge, of_vertex, along = np.inf, -1, begin, 0.0  # square of the distance
    for i in range(begin, end):
        j = i + 1 if i + 1 < end else begin
        dn, de = north - zones.vertices[i, 0], east - zones.vertices[i, 1]
        tn, te = zones.vertices[j, 0] - zones.vertices[i, 0], zones.vertices[j, 1] - zones.vertices[i, 1]
        square, product = tn * tn + te * te, dn * tn + de * te
        if 0.0 < product < square:
            across = dn * te - de * tn
            if across * across < best * square:
                best, of_edge, along = across * across / square, i, product / square
        if dn * dn + de * de < best:
            best, of_edge, of_vertex = dn * dn + de * de, -1, i
    distance, radius = np.sqrt(best), zones.radius[z]
    i = of_vertex if of_edge < 0 else of_edge
    qn, qe = zones.vertices[i, 0], zones.vertices[i, 1]
    if end - begin == 1:  # a disc
        side, mn, me = 1.0, 1.0, 0.0
    else:
        mn, me, tn, te = _edge_normal(zones, i, i + 1 if i + 1 < end else begin)
        if of_edge >= 0:
            qn, qe = qn + along * tn, qe + along * te
        else:
            bn, be, _, _ = _edge_normal(zones, i - 1 if i > begin else end - 1, i)
            mn, me = mn + bn, me + be
        side = 1.0 if (north - qn) * mn + (east - qe) * me >= 0.0 else -1.0
        size = max(np.hypot(mn, me), 1e-12)
        mn, me = mn / size, me / size
    if of_edge < 0 and distance > 0.0:
        mn, me = side * (north - qn) / distance, side * (east - qe) / distance
    return side * distance - radius, mn, me, qn + radius * mn, qe + radius * me


@jit
def _edge_normal(zones: Zones, i: int, j: int) -> tuple[float, float, float, float]:
    """Return the unit normal of the edge from vertex i to vertex j, to starboard, and the edge itself (m)."""
    tn, te = zones.vertices[j, 0] - zones.vertices[i, 0], zones.vertices[j, 1] - zones.vertices[i, 1]
    length = np.hypot(tn, te)
    if length == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    return -te / length, tn / length, tn, te


@jit
def clearances(zones: Zones, points: Array) -> Array:
    """Return the clearance (P, Z) in m of every point from every zone.

    Parameters
    ----------
    zones : zones of the fence.
    points : (P, 2) north and east (m).
    """
    out = np.empty((len(points), len(zones.radius)))
    for k in range(len(points)):
        for z in range(len(zones.radius)):
            out[k, z] = nearest(zones, z, points[k, 0], points[k, 1])[0]
    return out


@jit
def are_clear(zones: Zones, need: Array, points: Array) -> npt.NDArray[np.bool_]:
    """Return which points keep a required clearance from every zone: faster than to compute all clearances.

    Parameters
    ----------
    zones : zones of the fence.
    need : (Z,) required clearance (m).
    points : (P, 2) north and east (m).
    """
    clear = np.ones(len(points), dtype=np.bool_)
    for k in range(len(points)):
        n, e = points[k, 0], points[k, 1]
        for z in range(len(need)):
            from_circle = np.hypot(n - zones.circle[z, 0], e - zones.circle[z, 1]) - zones.circle[z, 2]
            if from_circle < need[z] and nearest(zones, z, n, e)[0] < need[z]:
                clear[k] = False
                break
    return clear
