"""Rows and cost of fence and corridor: half-planes that bound the predicted track.

At each knot k the QP has at most M = ``ROWS`` soft rows  a' dp_k >= b  in the deviation dp of the position, with the
outward normal m of a zone at its point nearest to the nominal position p, and its required clearance c:

    a = m / S,    b = (c - d(p)) / S,    cost of the excess: PENALTY g_k  for each S metres

d is the clearance (``geofence/zones.py``), S the scale of a position and g_k the length of the stage. An obstacle is a
disc at its predicted position at knot k. In a stage longer than the first one the rows are those of its point with the
least clearance, among points that are one first stage apart; the chord's sag is added to c between the knots.

A corridor of half width w along the path has two rows at each knot. With the unit normal m to starboard of the path's
nearest piece, and its point q, the cross-track distance is  x = m' (p - q):

    -m' dp / S >= (x - w) / S,    m' dp / S >= (-w - x) / S,    cost of the excess: CORRIDOR_PENALTY g_k  for each S

The cost of a trajectory has the same penalties on the true distances (line_search.py, nominal_trajectory.py):

    2 sum over k of  g_k (PENALTY sum over zones z of max(0, c_z - d_z) + CORRIDOR_PENALTY max(0, |x| - w)) / S

The factor 2 is that between the cost and the QP (cost.py). The penalty is exact: it is above the duals that occur,
because the target is never farther than the vehicle can come (fencing.py). That of the corridor is smaller, so that the
vehicle leaves its corridor rather than its fence.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.control.horizon_limits import NO_BOUND
from ltv_mpc.control.linearisation import unpack_linearisation
from ltv_mpc.control.problem_data import Objective, stage_length, unpack_constants
from ltv_mpc.geofence.half_planes import ROWS, SD_FACTOR, HalfPlanes, allocate, half_planes, insert_row
from ltv_mpc.geofence.obstacles import GROWTH_MPS
from ltv_mpc.geofence.zones import Zones, nearest
from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array

PENALTY = 5000.0
"""Cost of an excess of S (1 m for the paper's vehicle), over one stage of 0.3 s."""

CORRIDOR_PENALTY = 500.0
"""As ``PENALTY``, of an excess of the cross-track distance."""

CORRIDOR_ROWS = 2
"""Rows of the corridor at a knot, behind the ``ROWS`` of the fence."""

ACTIVE_M = 0.05
"""Surplus over the required clearance up to which a zone counts as active."""

REACH = 4.0
"""Largest slack of a row that is taken, in units of S."""

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
def _disc(scene: Scene, i: int, t_s: float) -> tuple[float, float, float]:
    """Return position and required clearance of an obstacle at a time after the first knot."""
    disc = scene.discs[i]
    growth = GROWTH_MPS * (disc[6] + t_s)
    sd = np.sqrt(disc[5] + growth * growth)
    return disc[0] + t_s * disc[2], disc[1] + t_s * disc[3], disc[4] + SD_FACTOR * sd + scene.disc_need_m[0]


@jit
def _sub_steps(o: Objective, k: int) -> int:
    """Return in how many points the stage that ends at knot k is looked at."""
    return max(int(np.ceil(stage_length(o, k) - 1e-6)), 1)


@jit
def _sag_m(X: Array, k: int, h: float) -> float:
    """Return how far the track leaves the chord of the stage that ends at knot k: v r h^2 / 8."""
    return float(np.hypot(X[k, 2], X[k, 3]) * abs(X[k, 5]) * h * h / 8.0)


@jit
def lack_m(scene: Scene, z: int, n: float, e: float, t_s: float) -> float:
    """Return by how much a point lacks the required clearance from zone z, or from obstacle z - Z; at least 0.

    Parameters
    ----------
    scene : zones and obstacles.
    z : number of the zone, or Z and the number of the obstacle.
    n, e : position (m).
    t_s : time after the first knot (s).
    """
    Z = len(scene.need)
    if z >= Z:
        north, east, need = _disc(scene, z - Z, t_s)
        return max(need - float(np.hypot(n - north, e - east)), 0.0)
    if scene.exits[z, 0] != 0.0:
        return float(max(scene.exits[z, 3] + scene.need[z] - scene.exits[z, 1] * n - scene.exits[z, 2] * e, 0.0))
    if _is_beyond(scene, z, (n, e, n, e)):
        return 0.0
    return float(max(scene.need[z] - nearest(scene.zones, z, n, e)[0], 0.0))


@jit_outlined
def fence_cost(X: Array, scene: Scene, o: Objective) -> float:
    """Return the cost of too small clearances, and of too large cross-track distances, along a trajectory.

    Parameters
    ----------
    X : (N+1, 8) states at the knots.
    scene : zones and obstacles.
    o : knots and scales.
    """
    total, count = 0.0, len(scene.need) + len(scene.discs)
    if len(scene.path) > 1:
        for k in range(1, X.shape[0]):
            excess = abs(cross_track(scene, k, X[k, 0], X[k, 1])[0]) - scene.half_width_m
            total += 2.0 * CORRIDOR_PENALTY * stage_length(o, k) * max(excess, 0.0) / o.state_scale[0]
    box = _box(X)
    for z in range(count):
        if z < len(scene.need) and _is_beyond(scene, z, box):
            continue
        for k in range(1, X.shape[0]):
            g, steps = stage_length(o, k), _sub_steps(o, k)
            worst = 0.0
            for j in range(1, steps + 1):
                part = j / steps
                n, e = X[k - 1, 0] + part * (X[k, 0] - X[k - 1, 0]), X[k - 1, 1] + part * (X[k, 1] - X[k - 1, 1])
                lack = lack_m(scene, z, n, e, (o.t[k - 1] + part * g) * scene.stage_s)
                if lack > 0.0 and j < steps:
                    lack += _sag_m(X, k, g * scene.stage_s)
                worst = max(worst, lack)
            total += 2.0 * PENALTY * g * worst / o.state_scale[0]
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


@jit
def is_near(packed: Array, flat: Array, stages: int, scene: Scene) -> bool:
    """Return True if the nominal trajectory comes near to a zone, an obstacle or the edge of the corridor.

    Parameters
    ----------
    packed : packed constants (problem_data.py).
    flat : ``Linearisation.flat``: its X is read.
    stages : N.
    scene : zones and obstacles.
    """
    o = unpack_constants(packed).objective
    spare = NEAR * o.state_scale[0]
    wide = Scene(
        scene.zones,
        scene.need + spare,
        scene.exits,
        scene.discs,
        scene.disc_need_m + spare,
        scene.stage_s,
        scene.path,
        scene.targets,
        scene.path_reach,
        scene.half_width_m - spare,
    )
    return bool(fence_cost(unpack_linearisation(flat, stages).X, wide, o) > 0.0)


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
    for k in range(1, stages + 1):
        g, steps = stage_length(o, k), _sub_steps(o, k)
        worst, at = -1.0, 1.0
        for j in range(steps, 0, -1):
            part = j / steps
            n, e = X[k - 1, 0] + part * (X[k, 0] - X[k - 1, 0]), X[k - 1, 1] + part * (X[k, 1] - X[k - 1, 1])
            lack = 0.0
            if steps > 1:
                for z in range(Z + len(scene.discs)):
                    lack = max(lack, lack_m(scene, z, n, e, (o.t[k - 1] + part * g) * scene.stage_s))
            if lack > worst:
                worst, at = lack, part
        for i in range(2):
            points[k - 1, i] = X[k - 1, i] + at * (X[k, i] - X[k - 1, i])
        times[k - 1] = (o.t[k - 1] + at * g) * scene.stage_s
        sag = _sag_m(X, k, g * scene.stage_s) if at < 1.0 else 0.0
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
    north, east, need = _disc(scene, i, t_s)
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


@jit
def entry_s(X: Array, t_s: Array, scene: Scene, hull_m: float) -> float:
    """Return when the hull enters a zone or an obstacle first (s after the first knot); infinite for never.

    Parameters
    ----------
    X, t_s, scene : as in ``clearance_table``.
    hull_m : radius of the hull (m).
    """
    first, box = np.inf, _box(X)
    for z in range(len(scene.need) + len(scene.discs)):
        if z < len(scene.need) and _is_beyond(scene, z, box):
            continue
        before = 0.0
        for k in range(X.shape[0]):
            distance, _ = _clearance(scene, z, X[k, 0], X[k, 1], t_s[k])
            if distance < hull_m:
                part = (before - hull_m) / (before - distance) if k > 0 else 0.0
                first = min(first, t_s[k - 1] + part * (t_s[k] - t_s[k - 1]) if k > 0 else 0.0)
                break
            before = distance
    return float(first)


@jit
def _clearance(scene: Scene, z: int, n: float, e: float, t_s: float) -> tuple[float, float]:
    """Return the clearance of a point from zone z, or from obstacle z - Z at a time, and the required one (m)."""
    Z = len(scene.need)
    if z < Z:
        return nearest(scene.zones, z, n, e)[0], scene.need[z]
    north, east, need = _disc(scene, z - Z, t_s)
    radius = scene.discs[z - Z, 4]
    return float(np.hypot(n - north, e - east)) - radius, need - radius


@jit
def clearance_table(X: Array, t_s: Array, scene: Scene) -> Array:
    """Return of each zone and each obstacle (Z + O, 4): what the plan keeps from it.

    Parameters
    ----------
    X : (N+1, 6) or (N+1, 8) states at the knots.
    t_s : (N+1,) times of the knots after the first one (s).
    scene : zones and obstacles.

    Returns
    -------
    Least clearance of the vehicle's origin (m), clearance at the first knot (m), smallest surplus over the required
    clearance (m), number of knots that lack more than 1 cm of it. The clearances of a zone that is neither active nor
    the nearest one are infinite.
    """
    count = len(scene.need) + len(scene.discs)
    out = np.zeros((count, 4))
    least, box = np.inf, _box(X)
    for z in range(count):
        out[z, 0] = out[z, 1] = out[z, 2] = np.inf
        if z < len(scene.need) and _from_box(scene.zones, z, box) > max(least, scene.need[z] + ACTIVE_M):
            continue
        for k in range(X.shape[0]):
            distance, need = _clearance(scene, z, X[k, 0], X[k, 1], t_s[k])
            if k == 0:
                out[z, 1] = distance
            out[z, 0], out[z, 2] = min(out[z, 0], distance), min(out[z, 2], distance - need)
            if distance < need - 0.01:
                out[z, 3] += 1.0
        least = min(least, out[z, 0])
    return out
