"""Clearances of a predicted track from zones and obstacles, their cost, and what a plan keeps from them.

The cost of a trajectory (nominal.py) counts, with the clearance d_z (``geofence/zones.py``)
and the required one c_z of zone z, the cross-track distance x in a corridor of half width w, the length g_k of a stage
and the scale S of a position:

    sum over k of  g_k (PENALTY sum over zones z of max(0, c_z - d_z) + CORRIDOR_PENALTY max(0, |x| - w)) / S

The penalty is exact: it is above the duals that occur,
because the target is never farther than the vehicle can come (target_placement.py), and because the weights of the
target are bounded (``scaling.bounded``). That of the corridor is smaller, so that the vehicle leaves its corridor
rather than its fence. An obstacle is a disc at its predicted position at knot k. A stage longer than the first one
counts with its point of the least clearance, among points that are one first stage apart; the chord's sag is added to c
between the knots.

A clearance changes by no more than the point moves. So after a point with a surplus over the required clearance, the
next points are not looked at until the track is longer by that surplus.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.control.problem_data import stage_length
from ltv_mpc.geofence.obstacles import GROWTH_MPS, SD_FACTOR
from ltv_mpc.geofence.zones import Zones, nearest
from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array

PENALTY = 5000.0
"""Cost of an excess of S (1 m for the paper's vehicle), over one stage of 0.3 s."""

CORRIDOR_PENALTY = 500.0
"""As ``PENALTY``, of an excess of the cross-track distance."""

ACTIVE_M = 0.05
"""Surplus over the required clearance up to which a zone counts as active."""

NEAR = 1.0
"""Surplus over a required clearance, in units of S, up to which a QP has the rows."""


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
    of_circle = _from_box(scene.zones, z, (n, e, n, e)) - scene.need[z]
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
    g = stage_length(t, k)
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
            total += factor * CORRIDOR_PENALTY * stage_length(t, k) * max(excess, 0.0)
    box = _box(X)
    for z in range(Z + len(scene.discs)):
        if z < Z and scene.exits[z, 0] == 0.0 and _from_box(scene.zones, z, box) > scene.need[z]:
            continue  # every point keeps its distance
        spare_m = 0.0
        for k in range(1, X.shape[0]):
            g = stage_length(t, k)
            worst, between, _, spare_m = stage_lack(scene, z, X, k, t, spare_m)
            if between > 0.0:
                worst = max(worst, sag_m(X, k, g * scene.stage_s) + between)
            total += factor * PENALTY * g * worst
    return total


@jit
def _box(X: Array) -> tuple[float, float, float, float]:
    """Return the least north and east of a trajectory, and the largest (m)."""
    n0, e0, n1, e1 = np.inf, np.inf, -np.inf, -np.inf
    for k in range(X.shape[0]):
        n0, n1 = min(n0, X[k, 0]), max(n1, X[k, 0])
        e0, e1 = min(e0, X[k, 1]), max(e1, X[k, 1])
    return n0, e0, n1, e1


@jit
def _from_box(zones: Zones, z: int, box: tuple[float, float, float, float]) -> float:
    """Return the distance of a box from the circle around zone z (m); infinitely negative for a keep-in zone."""
    n, e, radius = zones.circle[z]
    return float(np.hypot(max(box[0] - n, n - box[2], 0.0), max(box[1] - e, e - box[3], 0.0)) - radius)


def is_near(X: Array, scene: Scene, t: Array, scale_m: float) -> bool:
    """Return True if a trajectory comes near to a zone, an obstacle or the edge of the corridor.

    Parameters
    ----------
    X, scene, t, scale_m : as in ``fence_cost``.
    """
    spare_m = NEAR * scale_m
    need, disc_need_m, width_m = scene.need + spare_m, scene.disc_need_m + spare_m, scene.half_width_m - spare_m
    wide = scene._replace(need=need, disc_need_m=disc_need_m, half_width_m=width_m)
    return bool(fence_cost(X, wide, t, scale_m) > 0.0)


@jit_outlined
def _clearances(X: Array, t_s: Array, scene: Scene, near_m: float) -> tuple[Array, Array]:
    """Return the clearances (K, Z + O) of points from all zones and obstacles, and the required ones (m).

    Farther than ``near_m`` from the circle around a zone, the distance from the circle counts; the true one is larger.
    """
    Z, count = len(scene.need), len(scene.need) + len(scene.discs)
    free, need = np.empty((len(t_s), count)), np.empty((len(t_s), count))
    for k in range(len(t_s)):
        n, e = X[k, 0], X[k, 1]
        for z in range(Z):
            free[k, z], need[k, z] = _from_box(scene.zones, z, (n, e, n, e)), scene.need[z]
            if free[k, z] < near_m:
                free[k, z] = nearest(scene.zones, z, n, e)[0]
        for i in range(len(scene.discs)):
            north, east, required = disc_at(scene, i, t_s[k])
            free[k, Z + i] = np.hypot(n - north, e - east) - scene.discs[i, 4]
            need[k, Z + i] = required - scene.discs[i, 4]
    return free, need


def entry_s(X: Array, t_s: Array, scene: Scene, hull_m: float) -> float:
    """Return when the hull enters a zone or an obstacle first (s after the first knot); infinite for never.

    Parameters
    ----------
    X, t_s, scene : as in ``clearance_table``.
    hull_m : radius of the hull (m).
    """
    step_m = np.hypot(np.diff(X[:, 0]), np.diff(X[:, 1])).max()
    free = _clearances(X, t_s, scene, hull_m + step_m)[0] - hull_m
    if free.min(initial=0.0) >= 0.0:
        return math.inf
    if free[0].min() < 0.0:
        return 0.0
    zones = np.flatnonzero(free.min(axis=0) < 0.0)
    k = (free[:, zones] < 0.0).argmax(axis=0)
    before, after = free[k - 1, zones], free[k, zones]
    entries = t_s[k - 1] + before / (before - after) * (t_s[k] - t_s[k - 1])
    return float(entries.min())


def clearance_table(X: Array, t_s: Array, scene: Scene, hull_m: float) -> tuple[Array, float]:
    """Return what a plan keeps from each zone and each obstacle, and when the hull enters one first.

    Parameters
    ----------
    X : (N+1, 6) or (N+1, 8) states at the knots.
    t_s : (N+1,) times of the knots after the first one (s).
    scene : zones and obstacles.
    hull_m : radius of the hull (m).

    Returns
    -------
    (Z + O, 4) least clearance of the vehicle's origin (m), clearance at the first knot (m), smallest surplus over the
    required clearance (m), number of knots that lack more than 1 cm of it; and the time of ``entry_s``. Clearances that
    make a zone neither active nor the nearest one may be too small.
    """
    now = _clearances(X[:1], t_s[:1], scene, math.inf)[0][0]
    near_m = max(now.min(initial=math.inf), scene.need.max(initial=0.0) + ACTIVE_M)
    free, need = _clearances(X, t_s, scene, near_m)
    surplus, least = free - need, free.min(axis=0)
    table = np.column_stack([least, now, surplus.min(axis=0), (surplus < -0.01).sum(axis=0)])
    return table, entry_s(X, t_s, scene, hull_m) if least.min(initial=math.inf) < hull_m else math.inf
