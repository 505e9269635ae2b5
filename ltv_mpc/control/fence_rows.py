"""Rows and cost of the fence: half-planes that keep the predicted track from zones and obstacles.

At each knot k the QP has at most M = ``ROWS`` soft rows  a' dp_k >= b  in the deviation dp of the position, with the
outward normal m of a zone at its point nearest to the nominal position p, and its required clearance c:

    a = m / S,    b = (c - d(p)) / S,    cost of the excess: PENALTY g_k  for each S metres

d is the clearance (``geofence/zones.py``), S the scale of a position and g_k the length of the stage. An obstacle is a
disc at its predicted position at knot k. In a stage longer than the first one the rows are those of its point with the
least clearance, among points that are one first stage apart; the chord's sag is added to c between the knots.

The cost of a trajectory has the same penalty on the true clearances (line_search.py, nominal_trajectory.py):

    2 PENALTY sum over k, zones z of  g_k max(0, c_z - d_z) / S

The factor 2 is that between the cost and the QP (cost.py). The penalty is exact: it is above the duals that occur,
because the target is never farther than the vehicle can come (fencing.py).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.control.horizon_limits import NO_BOUND
from ltv_mpc.control.linearisation import unpack_linearisation
from ltv_mpc.control.problem_data import Objective, stage_length, unpack_constants
from ltv_mpc.geofence.half_planes import ALL, ROWS, SD_FACTOR, HalfPlanes, half_planes, insert_row
from ltv_mpc.geofence.obstacles import GROWTH_MPS
from ltv_mpc.geofence.zones import Zones, nearest
from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array

PENALTY = 5000.0
"""Cost of an excess of S (1 m for the paper's vehicle), over one stage of 0.3 s."""

REACH = 4.0
"""Largest slack of a row that is taken, in units of S."""


class Scene(NamedTuple):
    """Zones and obstacles of one cycle, for compiled code."""

    zones: Zones
    need: Array  # (Z,) required clearance of the vehicle's origin (m)
    exits: Array  # (Z, 4) half-plane of each zone that the vehicle is in, as ``half_planes`` takes them
    discs: Array  # (O, 7) obstacles, as ``ObstacleTable.discs``
    disc_need_m: Array  # (1,) hull and margin that are kept from an obstacle
    stage_s: float


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
    if scene.exits[z, 0] == ALL:
        return float(max(scene.exits[z, 3] + scene.need[z] - scene.exits[z, 1] * n - scene.exits[z, 2] * e, 0.0))
    circle = scene.zones.circle[z]
    if np.hypot(n - circle[0], e - circle[1]) - circle[2] > scene.need[z]:
        return 0.0
    return float(max(scene.need[z] - nearest(scene.zones, z, n, e)[0], 0.0))


@jit_outlined
def fence_cost(X: Array, scene: Scene, o: Objective) -> float:
    """Return the cost of too small clearances along a trajectory.

    Parameters
    ----------
    X : (N+1, 8) states at the knots.
    scene : zones and obstacles.
    o : knots and scales.
    """
    total, count = 0.0, len(scene.need) + len(scene.discs)
    if count == 0:
        return total
    for k in range(1, X.shape[0]):
        g, steps = stage_length(o, k), _sub_steps(o, k)
        sag = _sag_m(X, k, g * scene.stage_s)
        for z in range(count):
            worst = 0.0
            for j in range(1, steps + 1):
                part = j / steps
                n, e = X[k - 1, 0] + part * (X[k, 0] - X[k - 1, 0]), X[k - 1, 1] + part * (X[k, 1] - X[k - 1, 1])
                lack = lack_m(scene, z, n, e, (o.t[k - 1] + part * g) * scene.stage_s)
                if lack > 0.0 and j < steps:
                    lack += sag
                worst = max(worst, lack)
            total += 2.0 * PENALTY * g * worst / o.state_scale[0]
    return total


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
    rows = HalfPlanes(
        np.zeros((stages, ROWS, 2)),
        np.zeros((stages, ROWS)),
        np.zeros((stages, ROWS)),
        np.full((stages, ROWS), -1),
    )
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
def clearance_table(X: Array, t_s: Array, scene: Scene, hull_m: float) -> Array:
    """Return of each zone and each obstacle (Z + O, 5): what the plan keeps from it.

    Parameters
    ----------
    X : (N+1, 6) or (N+1, 8) states at the knots.
    t_s : (N+1,) times of the knots after the first one (s).
    scene : zones and obstacles.
    hull_m : radius of the hull (m).

    Returns
    -------
    Least clearance of the vehicle's origin (m), clearance at the first knot (m), smallest surplus over the required
    clearance (m), number of knots that lack more than 1 cm of it, time at which the hull enters it (s; inf: never).
    """
    Z, count = len(scene.need), len(scene.need) + len(scene.discs)
    out = np.zeros((count, 5))
    for z in range(count):
        out[z, 0], out[z, 2], out[z, 4] = np.inf, np.inf, np.inf
        before = 0.0
        for k in range(X.shape[0]):
            if z < Z:
                distance, need = nearest(scene.zones, z, X[k, 0], X[k, 1])[0], scene.need[z]
            else:
                north, east, need = _disc(scene, z - Z, t_s[k])
                radius = scene.discs[z - Z, 4]
                distance, need = np.hypot(X[k, 0] - north, X[k, 1] - east) - radius, need - radius
            if k == 0:
                out[z, 1] = distance
            out[z, 0], out[z, 2] = min(out[z, 0], distance), min(out[z, 2], distance - need)
            if distance < need - 0.01:
                out[z, 3] += 1.0
            if distance < hull_m and np.isinf(out[z, 4]):
                part = (before - hull_m) / (before - distance) if k > 0 else 0.0
                out[z, 4] = t_s[k - 1] + part * (t_s[k] - t_s[k - 1]) if k > 0 else 0.0
            before = distance
    return out
