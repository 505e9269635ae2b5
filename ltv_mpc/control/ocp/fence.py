"""Fence and corridor: half-planes that bound the predicted track, soft.

At each knot k there are at most ``ROWS`` rows  m' dp_k / S >= b  in the deviation dp of the position, with the outward
normal m of a zone at its point nearest to the nominal position p, and its required clearance c:

    b = (c - d(p)) / S,    cost of the excess: PENALTY g_k  for each S metres

d is the clearance (``geofence/zones.py``), S the scale of a position and g_k the length of the stage. In a stage longer
than the first one the rows are those of its point with the least clearance.

A corridor of half width w along the path has two rows at each knot. With the unit normal m to starboard of the path's
nearest piece, and its point q, the cross-track distance is  x = m' (p - q):

    -m' dp / S >= (x - w) / S,    m' dp / S >= (-w - x) / S,    cost of the excess: CORRIDOR_PENALTY g_k
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.fence_clearance import CORRIDOR_PENALTY, PENALTY, Scene, cross_track, disc_at, sag_m, stage_lack
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import Constants, stage_length
from ltv_mpc.geofence.half_planes import ROWS, HalfPlanes, half_planes, insert_row
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

CORRIDOR_ROWS = 2
"""Rows of the corridor at a knot, behind the ``ROWS`` of the fence."""

REACH = 4.0
"""Largest slack of a row that is taken, in units of S."""


@jit
def fill(o: Constants, X: Array, scene: Scene, rows: int, p: Problem) -> None:
    """Fill in the rows of a cycle, which are the last ones of a problem.

    Parameters
    ----------
    o : constants of the controller.
    X : (N+1, 8) nominal states.
    scene : zones and obstacles.
    rows : how many rows a knot has for fence and corridor.
    p : problem; these rows are overwritten.
    """
    stages = len(p.f)
    Z, scale, first = len(scene.need), o.state_scale[0], p.G.shape[1] - rows
    points, required = np.empty((stages, 2)), np.empty((stages, Z))
    times, reach = np.empty(stages), np.full(stages, REACH * scale)
    at = _worst_points(X, scene, o.t)
    for k in range(1, stages + 1):
        g = stage_length(o.t, k)
        for i in range(2):
            points[k - 1, i] = X[k - 1, i] + at[k - 1] * (X[k, i] - X[k - 1, i])
        times[k - 1] = (o.t[k - 1] + at[k - 1] * g) * scene.stage_s
        sag = sag_m(X, k, g * scene.stage_s) if at[k - 1] < 1.0 else 0.0
        for z in range(Z):
            required[k - 1, z] = scene.need[z] + sag
    found = half_planes(scene.zones, points, required, scene.exits, reach)
    for k in range(1, stages + 1):
        for i in range(len(scene.discs)):
            _insert_disc(scene, i, times[k - 1], k - 1, points, reach[k - 1], found)
        g = stage_length(o.t, k)
        for j in range(ROWS):
            if found.zone[k - 1, j] >= 0:
                normal = found.normal[k - 1, j]
                _set_row(p, k, first + j, normal[0], normal[1], -found.slack[k - 1, j] / scale, PENALTY * g)
        if rows > ROWS and len(scene.path) > 1:
            distance, mn, me = cross_track(scene, k, X[k, 0], X[k, 1])
            for j, side in ((ROWS, -1.0), (ROWS + 1, 1.0)):
                low = -(scene.half_width_m + side * distance) / scale
                _set_row(p, k, first + j, side * mn, side * me, low, CORRIDOR_PENALTY * g)


@jit
def _set_row(p: Problem, k: int, row: int, north: float, east: float, low: float, penalty: float) -> None:
    """Set the row  normal' dp / S >= low."""
    p.G[k, row, 0], p.G[k, row, 1] = north, east
    p.low[k, row], p.penalty[k, row] = low, penalty


@jit
def _worst_points(X: Array, scene: Scene, t: Array) -> Array:
    """Return where each stage has its point of the least clearance, as a share (N,) of the stage; 1 if none lacks."""
    N, Z = X.shape[0] - 1, len(scene.need)
    at, worst = np.ones(N), np.zeros(N)
    for z in range(Z + len(scene.discs)):
        spare_m = 0.0
        for k in range(1, N + 1):
            knot, between, part, spare_m = stage_lack(scene, z, X, k, t, spare_m)
            if between > worst[k - 1]:
                at[k - 1], worst[k - 1] = part, between
            if knot > worst[k - 1]:
                at[k - 1], worst[k - 1] = 1.0, knot
    return at


@jit
def _insert_disc(scene: Scene, i: int, t_s: float, k: int, points: Array, reach: float, rows: HalfPlanes) -> None:
    """Insert the row of an obstacle for a point."""
    north, east, need = disc_at(scene, i, t_s)
    dn, de = points[k, 0] - north, points[k, 1] - east
    distance = np.hypot(dn, de)
    if distance > need + reach:
        return
    if distance > 0.0:
        mn, me = dn / distance, de / distance
    else:
        mn, me = 1.0, 0.0
    offset = mn * north + me * east + need
    insert_row(rows, k, len(scene.need) + i, mn, me, offset, mn * points[k, 0] + me * points[k, 1])
