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
def sub_steps(t: Array, k: int) -> int:
    """Return in how many points the stage that ends at knot k is looked at.

    Parameters
    ----------
    t : (N+1,) knots in first stages.
    k : knot.
    """
    return max(int(np.ceil(stage_length(t, k) - 1e-6)), 1)


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
    g, steps = stage_length(t, k), sub_steps(t, k)
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
        if z < Z and _is_beyond(scene, z, box):
            continue
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


@jit
def _is_beyond(scene: Scene, z: int, box: tuple[float, float, float, float]) -> bool:
    """Return True if every point of a box has the required clearance from zone z; False if that takes a closer look."""
    return bool(scene.exits[z, 0] == 0.0 and _from_box(scene.zones, z, box) > scene.need[z])


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


@jit
def entry_s(X: Array, t_s: Array, scene: Scene, hull_m: float) -> float:
    """Return when the hull enters a zone or an obstacle first (s after the first knot); infinite for never.

    Parameters
    ----------
    X, t_s, scene : as in ``clearance_table``.
    hull_m : radius of the hull (m).
    """
    first, box, Z = np.inf, _box(X), len(scene.need)
    for z in range(Z + len(scene.discs)):
        if z < Z and _is_beyond(scene, z, box):
            continue
        spare_m = 0.0
        for k in range(X.shape[0]):
            spare_m -= _moved_m(X, k)
            if spare_m > 0.0:
                continue
            free = _clearance(scene, z, X[k, 0], X[k, 1], t_s[k])[0] - hull_m
            if free < 0.0:
                entry = 0.0
                if k > 0:
                    before = _clearance(scene, z, X[k - 1, 0], X[k - 1, 1], t_s[k - 1])[0] - hull_m
                    entry = t_s[k - 1] + before / (before - free) * (t_s[k] - t_s[k - 1])
                first = min(first, entry)
                break
            spare_m = free if z < Z else 0.0
    return float(first)


@jit
def _moved_m(X: Array, k: int) -> float:
    """Return the distance from the knot before; 0 at the first one."""
    return float(np.hypot(X[k, 0] - X[k - 1, 0], X[k, 1] - X[k - 1, 1])) if k > 0 else 0.0


@jit
def _clearance(scene: Scene, z: int, n: float, e: float, t_s: float) -> tuple[float, float]:
    """Return the clearance of a point from zone z, or from obstacle z - Z at a time, and the required one (m)."""
    Z = len(scene.need)
    if z < Z:
        return nearest(scene.zones, z, n, e)[0], scene.need[z]
    north, east, need = disc_at(scene, z - Z, t_s)
    radius = scene.discs[z - Z, 4]
    return float(np.hypot(n - north, e - east)) - radius, need - radius


@jit
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
    make a zone neither active nor the nearest one may be infinite.
    """
    Z, count, last = len(scene.need), len(scene.need) + len(scene.discs), X.shape[0] - 1
    out = np.zeros((count, 4))
    least, box = np.inf, _box(X)
    for z in range(count):
        out[z, 0] = out[z, 1] = out[z, 2] = np.inf
        if z < Z and _from_box(scene.zones, z, box) > max(least, scene.need[z] + ACTIVE_M):
            continue
        spare_m = 0.0
        for i in range(-1, last):  # the last knot first: it is often the nearest one
            k = i if i >= 0 else last
            spare_m -= _moved_m(X, k) if i >= 0 else 0.0
            if spare_m > 0.0:
                continue
            distance, need = _clearance(scene, z, X[k, 0], X[k, 1], t_s[k])
            if k == 0:
                out[z, 1] = distance
            out[z, 0], out[z, 2] = min(out[z, 0], distance), min(out[z, 2], distance - need)
            if distance < need - 0.01:
                out[z, 3] += 1.0
            least = min(least, distance)
            if i >= 0 and z < Z:
                spare_m = distance - max(least, need + ACTIVE_M)
    return out, entry_s(X, t_s, scene, hull_m) if least < hull_m else np.inf
