"""Rows of fence and corridor in the QP: half-planes that bound the predicted track.

At each knot k the QP has at most M = ``ROWS`` soft rows  a' dp_k >= b  in the deviation dp of the position, with the
outward normal m of a zone at its point nearest to the nominal position p, and its required clearance c:

    a = m / S,    b = (c - d(p)) / S,    cost of the excess: PENALTY g_k  for each S metres

d is the clearance (``geofence/zones.py``), S the scale of a position and g_k the length of the stage. In a stage longer
than the first one the rows are those of its point with the least clearance.

A corridor of half width w along the path has two rows at each knot. With the unit normal m to starboard of the path's
nearest piece, and its point q, the cross-track distance is  x = m' (p - q):

    -m' dp / S >= (x - w) / S,    m' dp / S >= (-w - x) / S,    cost of the excess: CORRIDOR_PENALTY g_k
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.fence_clearance import CORRIDOR_PENALTY, PENALTY, Scene, cross_track, disc_at, sag_m, stage_lack
from ltv_mpc.control.horizon_limits import NO_BOUND
from ltv_mpc.control.linearisation import advance_deviation, unpack_linearisation
from ltv_mpc.control.problem_data import Objective, stage_length, unpack_constants
from ltv_mpc.geofence.half_planes import ROWS, HalfPlanes, allocate, half_planes, insert_row
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES

CORRIDOR_ROWS = 2
"""Rows of the corridor at a knot, behind the ``ROWS`` of the fence."""

REACH = 4.0
"""Largest slack of a row that is taken, in units of S."""


@jit
def fill_rows(packed: Array, flat: Array, stages: int, scene: Scene) -> None:
    """Write the rows of a cycle.

    Parameters
    ----------
    packed : packed constants (problem_data.py).
    flat : ``Linearisation.flat``: its X is read, its rows are overwritten.
    stages : N.
    scene : zones and obstacles.
    """
    o, lin = unpack_constants(packed).objective, unpack_linearisation(flat, stages)
    X, Z = lin.X, len(scene.need)
    scale = o.state_scale[0]
    points, required = np.empty((stages, 2)), np.empty((stages, Z))
    times, reach = np.empty(stages), np.full(stages, REACH * scale)
    at = _worst_points(X, scene, o)
    for k in range(1, stages + 1):
        g = stage_length(o, k)
        for i in range(2):
            points[k - 1, i] = X[k - 1, i] + at[k - 1] * (X[k, i] - X[k - 1, i])
        times[k - 1] = (o.t[k - 1] + at[k - 1] * g) * scene.stage_s
        sag = sag_m(X, k, g * scene.stage_s) if at[k - 1] < 1.0 else 0.0
        for z in range(Z):
            required[k - 1, z] = scene.need[z] + sag
    rows = allocate(stages)
    half_planes(scene.zones, points, required, scene.exits, reach, rows)
    for k in range(stages):
        for i in range(len(scene.discs)):
            _insert_disc(scene, i, times[k], k, points, reach[k], rows)
        for j in range(ROWS):
            used = rows.zone[k, j] >= 0
            for i in range(2):
                lin.rows[k, j, i] = rows.normal[k, j, i] / scale if used else 0.0
            lin.rows[k, j, 2] = -rows.slack[k, j] / scale if used else -NO_BOUND
            lin.rows[k, j, 3] = PENALTY * stage_length(o, k + 1)
        if lin.rows.shape[1] > ROWS:
            _fill_corridor(lin.rows[k, ROWS:], scene, k + 1, X[k + 1], o)


@jit
def _worst_points(X: Array, scene: Scene, o: Objective) -> Array:
    """Return where each stage has its point of the least clearance, as a share (N,) of the stage; 1 if none lacks."""
    N, Z = X.shape[0] - 1, len(scene.need)
    at, worst = np.ones(N), np.zeros(N)
    for z in range(Z + len(scene.discs)):
        spare_m = 0.0
        for k in range(1, N + 1):
            knot, between, part, spare_m = stage_lack(scene, z, X, k, o, spare_m)
            if between > worst[k - 1]:
                at[k - 1], worst[k - 1] = part, between
            if knot > worst[k - 1]:
                at[k - 1], worst[k - 1] = 1.0, knot
    return at


@jit
def least_surplus(flat: Array, stages: int, commands: Array) -> float:
    """Return by how much the linear model meets every row with some commands; negative: not all are met.

    Parameters
    ----------
    flat : ``Linearisation.flat`` with rows.
    stages : N.
    commands : (N+1, 2) port and starboard thrust (N).

    Returns
    -------
    The least of a' dp_k - b, in units of S.
    """
    lin = unpack_linearisation(flat, stages)
    least, dU, d, last = np.inf, commands - lin.U, np.zeros(STATES), np.zeros(STATES)
    for k in range(stages):
        advance_deviation(lin, k, dU, last, d)
        for j in range(lin.rows.shape[1]):
            row = lin.rows[k, j]
            least = min(least, row[0] * d[0] + row[1] * d[1] - row[2])
    return float(least)


@jit
def _fill_corridor(rows: Array, scene: Scene, k: int, x: Array, o: Objective) -> None:
    """Write the rows (2, 4) of the corridor at knot k, whose nominal state is x."""
    scale = o.state_scale[0]
    for j in range(len(rows)):
        rows[j, 0] = rows[j, 1] = 0.0
        rows[j, 2] = -NO_BOUND
        rows[j, 3] = CORRIDOR_PENALTY * stage_length(o, k)
    if len(scene.path) > 1:
        distance, mn, me = cross_track(scene, k, x[0], x[1])
        for j, side in ((0, -1.0), (1, 1.0)):
            rows[j, 0], rows[j, 1] = side * mn / scale, side * me / scale
            rows[j, 2] = -(scene.half_width_m + side * distance) / scale


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
