"""Half-planes that keep the points of a predicted track out of the zones: at most ``ROWS`` a point.

A row (m, b) asks a point p for  m . p >= b.  With the boundary's nearest point q and outward normal m, and the required
clearance c of the zone at this point, b = m . q + c. A polygon gives one row for every place of its boundary that is
nearest in its surroundings: edges whose foot lies on them, and corners that reach into the allowed side. The rows with
the least slack  m . p - b  are taken, and only those with less than ``reach``.

A point inside a zone is pushed to the nearest boundary. Where the vehicle itself is inside, a zone has an exit: its one
half-plane is that of all points, so that they do not leave on different sides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.geofence.zones import Zones, nearest
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

ROWS = 3
"""Largest number of rows M of one point."""


class HalfPlanes(NamedTuple):
    """Rows of the points of a track; those that are not used have the zone -1."""

    normal: Array  # (P, M, 2)
    offset: Array  # (P, M) (m)
    slack: Array  # (P, M) m . p - b (m), ascending
    zone: npt.NDArray[np.int64]  # (P, M)


@jit
def half_planes(zones: Zones, points: Array, required: Array, exits: Array, reach: Array) -> HalfPlanes:
    """Return the rows of every point.

    Parameters
    ----------
    zones : zones of the fence.
    points : (P, 2) north and east (m): the linearisation's positions at knots and sub-steps.
    required : (P, Z) required clearance (m).
    exits : (Z, 4) exit of each zone: 1 if it has one or 0, its half-plane's m north, m east and offset (m).
    reach : (P,) largest slack of a row that is taken (m).
    """
    P = len(points)
    rows = HalfPlanes(np.empty((P, ROWS, 2)), np.empty((P, ROWS)), np.empty((P, ROWS)), np.empty((P, ROWS), np.int64))
    for k in range(P):
        for i in range(ROWS):
            rows.zone[k, i] = -1
        north, east = points[k, 0], points[k, 1]
        for z in range(len(zones.radius)):
            need = required[k, z]
            away = np.hypot(north - zones.circle[z, 0], east - zones.circle[z, 1]) - zones.circle[z, 2]
            if away > need + reach[k] and exits[z, 0] == 0.0:
                continue
            distance, mn, me, qn, qe = nearest(zones, z, north, east)
            if exits[z, 0] != 0.0:
                mn, me = exits[z, 1], exits[z, 2]
                insert_row(rows, k, z, mn, me, exits[z, 3] + need, mn * north + me * east)
            elif distance < 0.0 or zones.first[z + 1] - zones.first[z] == 1:
                if distance < need + reach[k]:
                    insert_row(rows, k, z, mn, me, mn * qn + me * qe + need, mn * north + me * east)
            else:
                _insert_ring(zones, z, k, points, need + reach[k], need, rows)
    return rows


@jit
def _insert_ring(zones: Zones, z: int, k: int, points: Array, far: float, need: float, rows: HalfPlanes) -> None:
    """Insert the rows of a polygon for a point on the allowed side: its edges and corners nearer than ``far``."""
    begin, end = zones.first[z], zones.first[z + 1]
    north, east = points[k, 0], points[k, 1]
    for i in range(begin, end):
        n0, e0 = zones.vertices[i, 0], zones.vertices[i, 1]
        j = i + 1 if i + 1 < end else begin
        h = i - 1 if i > begin else end - 1
        tn, te = zones.vertices[j, 0] - n0, zones.vertices[j, 1] - e0
        length = np.hypot(tn, te)
        along = ((north - n0) * tn + (east - e0) * te) / length
        distance = ((east - e0) * tn - (north - n0) * te) / length  # to starboard of the edge
        if 0.0 <= along <= length and 0.0 <= distance < far:
            mn, me = -te / length, tn / length
            insert_row(rows, k, z, mn, me, mn * n0 + me * e0 + need, mn * north + me * east)
        bn, be = n0 - zones.vertices[h, 0], e0 - zones.vertices[h, 1]
        distance = np.hypot(north - n0, east - e0)
        # beyond the end of the edge before, and before the begin of this one
        if along < 0.0 and (north - n0) * bn + (east - e0) * be > 0.0 and 0.0 < distance < far:
            mn, me = (north - n0) / distance, (east - e0) / distance
            insert_row(rows, k, z, mn, me, mn * n0 + me * e0 + need, mn * north + me * east)


@jit
def insert_row(rows: HalfPlanes, k: int, z: int, mn: float, me: float, offset: float, value: float) -> None:
    """Insert a row of point k in the order of slack; the last one drops out.

    Parameters
    ----------
    rows : of all points.
    k : number of the point.
    z : number of the zone.
    mn, me : normal m.
    offset : b (m).
    value : m . p of the point p (m).
    """
    i = ROWS
    slack = value - offset
    while i > 0 and (rows.zone[k, i - 1] < 0 or slack < rows.slack[k, i - 1]):
        i -= 1
    if i == ROWS:
        return
    for j in range(ROWS - 1, i, -1):
        rows.normal[k, j, 0], rows.normal[k, j, 1] = rows.normal[k, j - 1, 0], rows.normal[k, j - 1, 1]
        rows.offset[k, j], rows.slack[k, j] = rows.offset[k, j - 1], rows.slack[k, j - 1]
        rows.zone[k, j] = rows.zone[k, j - 1]
    rows.normal[k, i, 0], rows.normal[k, i, 1] = mn, me
    rows.offset[k, i], rows.slack[k, i], rows.zone[k, i] = offset, slack, z
