"""Fence and corridor: half-planes that bound the predicted track, soft.

At each knot k there are at most ``ROWS`` rows  m' dp_k / S >= b  in the deviation dp of the position, with the outward
normal m of a zone at its point nearest to the nominal position p, and its required clearance c:

    b = (c - d(p)) / S,    cost of the excess: PENALTY g_k  for each S metres

d is the clearance (``geofence/zones.py``), S the scale of a position and g_k the length of the stage. In a stage longer
than the first one the rows are those of its point with the least clearance.

A corridor of half width w along the path has two rows at each knot. With the unit normal m to starboard of the path's
nearest piece, and its point q, the cross-track distance is  x = m' (p - q):

    -m' dp / S >= (x - w) / S,    m' dp / S >= (-w - x) / S,    cost of the excess: CORRIDOR_PENALTY g_k

The cost of a trajectory (nominal.py) counts

    sum over k of  g_k (PENALTY sum over zones z of max(0, c_z - d_z) + CORRIDOR_PENALTY max(0, |x| - w)) / S

over the zones z with their clearances d_z and required ones c_z. The penalty is exact: it is above the duals that
occur, because the target is never farther than the vehicle can come (target_placement.py), and because the weights of
the target are bounded (``scaling.bounded``). That of the corridor is smaller, so that the vehicle leaves its corridor
rather than its fence. An obstacle is a disc at its predicted position at knot k. A stage longer than the first one
counts with its point of the least clearance, among points that are one first stage apart; the chord's sag is added to c
between the knots.

A clearance changes by no more than the point moves. So after a point with a surplus over the required clearance, the
next points are not looked at until the track is longer by that surplus.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.geofence.half_planes import ROWS, HalfPlanes, half_planes, insert_row
from ltv_mpc.geofence.obstacles import GROWTH_MPS, SD_FACTOR
from ltv_mpc.geofence.zones import Zones, nearest
from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array

PENALTY = 5000.0
"""Cost of an excess of S (1 m for the paper's vehicle), over one stage of 0.3 s."""

CORRIDOR_PENALTY = 500.0
"""As ``PENALTY``, of an excess of the cross-track distance."""


class Scene(NamedTuple):
    """Zones and obstacles of one cycle, for compiled code."""

    zones: Zones
    need: Array  # (Z,) required clearance of the vehicle's origin (m)
    exits: Array  # (Z, 4) exit of each zone that the vehicle is in, as ``half_planes`` takes them
    discs: Array  # (O, 7) obstacles, as ``ObstacleTable.discs``
    disc_need_m: Array  # (1,) hull and margin that are kept from an obstacle
    stage_s: float
    path: Array  # (K, 2) points of the path beside the horizon (m); none: the corridor does not bound
    targets: npt.NDArray[np.int64]  # (N,) point of the path before the target of each knot
    path_reach: int  # pieces of the path in which its nearest point is searched, to either side of the target
    half_width_m: float  # of the corridor


NO_PATH = np.empty((0, 2))
"""Path of a corridor that does not bound."""


@jit
def cross_track(scene: Scene, k: int, n: float, e: float) -> tuple[float, float, float]:
    """Return the distance of a point from the path beside knot k = 1 .. N, positive to starboard, and the normal there.

    Parameters
    ----------
    scene : its path has at least two points.
    k : knot.
    n, e : position (m).

    Returns
    -------
    Distance from the line through the nearest piece (m); unit normal to starboard, north and east; zeros if the path
    has no length.
    """
    nearest_m, x, mn, me = np.inf, 0.0, 0.0, 0.0
    first, last = scene.targets[k - 1] - scene.path_reach, scene.targets[k - 1] + scene.path_reach
    for i in range(max(first, 0), min(last, len(scene.path) - 2) + 1):
        tn, te = scene.path[i + 1, 0] - scene.path[i, 0], scene.path[i + 1, 1] - scene.path[i, 1]
        length = np.hypot(tn, te)
        if length < 1e-9:
            continue
        dn, de = n - scene.path[i, 0], e - scene.path[i, 1]
        along = min(max((dn * tn + de * te) / length, 0.0), length)
        distance = np.hypot(dn - along * tn / length, de - along * te / length)
        if distance < nearest_m:
            nearest_m, mn, me = distance, -te / length, tn / length
            x = mn * dn + me * de
    return x, mn, me


@jit
def disc_at(scene: Scene, i: int, t_s: float) -> tuple[float, float, float]:
    """Return position (m) and required clearance (m) of an obstacle.

    Parameters
    ----------
    scene : has the obstacle.
    i : number of the obstacle.
    t_s : time after the first knot (s).
    """
    disc = scene.discs[i]
    growth = GROWTH_MPS * (disc[6] + t_s)
    sd = np.sqrt(disc[5] + growth * growth)
    return disc[0] + t_s * disc[2], disc[1] + t_s * disc[3], disc[4] + SD_FACTOR * sd + scene.disc_need_m[0]


@jit
def sag_m(X: Array, k: int, h: float) -> float:
    """Return how far the track leaves the chord of the stage that ends at knot k: v r h^2 / 8 (m).

    Parameters
    ----------
    X : (N+1, 8) states at the knots.
    k : knot.
    h : length of the stage (s).
    """
    return float(np.hypot(X[k, 2], X[k, 3]) * abs(X[k, 5]) * h * h / 8.0)


@jit
def surplus_m(scene: Scene, z: int, n: float, e: float, t_s: float) -> float:
    """Return by how much a point exceeds the required clearance from zone z, or from obstacle z - Z; negative: lacks.

    Parameters
    ----------
    scene : zones and obstacles.
    z : number of the zone, or Z and the number of the obstacle.
    n, e : position (m).
    t_s : time after the first knot (s).

    Returns
    -------
    The surplus (m). Where it is positive outside the circle around the zone, it is that over the circle.
    """
    Z = len(scene.need)
    if z >= Z:
        north, east, need = disc_at(scene, z - Z, t_s)
        return float(np.hypot(n - north, e - east)) - need
    if scene.exits[z, 0] != 0.0:
        return float(scene.exits[z, 1] * n + scene.exits[z, 2] * e - scene.exits[z, 3] - scene.need[z])
    of_circle = from_box(scene.zones, z, (n, e, n, e)) - scene.need[z]
    if of_circle > 0.0:
        return float(of_circle)
    return float(nearest(scene.zones, z, n, e)[0] - scene.need[z])


@jit
def stage_lack(scene: Scene, z: int, X: Array, k: int, t: Array, spare_m: float) -> tuple[float, float, float, float]:
    """Return the largest lack of clearance from one zone or obstacle in the stage that ends at knot k.

    Parameters
    ----------
    scene, z : as in ``surplus_m``.
    X : (N+1, 8) states at the knots.
    k : knot.
    t : (N+1,) knots in first stages.
    spare_m : length of the track from knot k - 1 on which the clearance is surely kept (m).

    Returns
    -------
    Lack at the knot (m), largest lack between the knots (m), where that is as a share of the stage, and the length of
    ``spare_m`` from knot k on (m). A lack is 0 where there is none.
    """
    g = t[k] - t[k - 1]
    steps = max(int(np.ceil(g - 1e-6)), 1)  # points that are looked at
    dn, de = (X[k, 0] - X[k - 1, 0]) / steps, (X[k, 1] - X[k - 1, 1]) / steps
    moved_m, knot, between, part = np.hypot(dn, de), 0.0, 0.0, 1.0
    for j in range(1, steps + 1):
        spare_m -= moved_m
        if spare_m > 0.0:
            continue
        t_s = (t[k - 1] + j / steps * g) * scene.stage_s
        surplus = surplus_m(scene, z, X[k - 1, 0] + j * dn, X[k - 1, 1] + j * de, t_s)
        spare_m = surplus if z < len(scene.need) else 0.0  # obstacles move, too
        if j == steps:
            knot = max(-surplus, 0.0)
        elif -surplus > between:
            between, part = -surplus, j / steps
    return knot, between, part, spare_m


@jit_outlined
def fence_cost(X: Array, scene: Scene, t: Array, scale_m: float) -> float:
    """Return the cost of too small clearances, and of too large cross-track distances, along a trajectory.

    Parameters
    ----------
    X : (N+1, 8) states at the knots.
    scene : zones and obstacles.
    t : (N+1,) knots in first stages.
    scale_m : S.
    """
    total, Z, factor = 0.0, len(scene.need), 1.0 / scale_m
    if len(scene.path) > 1:
        for k in range(1, X.shape[0]):
            excess = abs(cross_track(scene, k, X[k, 0], X[k, 1])[0]) - scene.half_width_m
            total += factor * CORRIDOR_PENALTY * (t[k] - t[k - 1]) * max(excess, 0.0)
    box = X[:, 0].min(), X[:, 1].min(), X[:, 0].max(), X[:, 1].max()
    for z in range(Z + len(scene.discs)):
        if z < Z and scene.exits[z, 0] == 0.0 and from_box(scene.zones, z, box) > scene.need[z]:
            continue  # every point keeps its distance
        spare_m = 0.0
        for k in range(1, X.shape[0]):
            g = t[k] - t[k - 1]
            worst, between, _, spare_m = stage_lack(scene, z, X, k, t, spare_m)
            if between > 0.0:
                worst = max(worst, sag_m(X, k, g * scene.stage_s) + between)
            total += factor * PENALTY * g * worst
    return total


@jit
def from_box(zones: Zones, z: int, box: tuple[float, float, float, float]) -> float:
    """Return the distance of a box from the circle around zone z (m); infinitely negative for a keep-in zone.

    Parameters
    ----------
    zones : of the fence.
    z : number of the zone.
    box : least north and east, then the largest (m).
    """
    n, e, radius = zones.circle[z]
    return float(np.hypot(max(box[0] - n, n - box[2], 0.0), max(box[1] - e, e - box[3], 0.0)) - radius)


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
        g = o.t[k] - o.t[k - 1]
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
        g = o.t[k] - o.t[k - 1]
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
