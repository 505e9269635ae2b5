"""Shortest way round the zones: a visibility graph of their grown corners (Lozano-Perez & Wesley 1979).

The corners of all zones, moved outwards by the required clearance, are the nodes. Two nodes are neighbours if the line
between them keeps the clearance from every zone. A disc, and a corner that reaches into the allowed side, has nodes on
an arc around it. The way that was chosen last is kept unless another one is shorter by the share ``SHORTER``: otherwise
the vehicle could change its mind with every estimate.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from ltv_mpc.geofence.zones import Zones, clearance, clearances
from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array

ARC_RAD = math.pi / 6.0
"""Largest angle between two nodes on an arc."""

OUTSIDE = 1.01
"""Distance of the nodes over the required clearance, so that rounding does not block the lines between them."""

SHORTER = 0.05
"""Share by which another way must be shorter."""

SLACK_M = 1e-3
"""Clearance that a line may lack, at least."""


class Router:
    """Shortest ways round the zones of one fence."""

    def __init__(self, zones: Zones, need: Array) -> None:
        """Compute nodes and distances.

        Parameters
        ----------
        zones : zones of the fence.
        need : (Z,) required clearance (m).
        """
        self.zones = zones
        """Zones of the fence."""
        self.need = need.copy()
        """(Z,) clearance that the ways keep (m)."""
        nodes = np.array(list(_nodes(zones, need * OUTSIDE))).reshape(-1, 2)
        self._nodes = nodes[(clearances(zones, nodes) >= need - SLACK_M).all(axis=1)]
        self._lengths = _visible_lengths(zones, self.need, self._nodes)
        self._way = np.empty((0, 2))
        self._goal = np.full(2, np.nan)  # of the distances that are kept, as a point keeps it for many cycles
        self._to_goal = self._lengths[:0], np.empty(0, dtype=np.int64)

    def serves(self, need: Array) -> bool:
        """Return True if the ways suit other required clearances: at most 5 cm too near, and not a quarter too far.

        Parameters
        ----------
        need : (Z,) required clearance (m).
        """
        return bool(_suits(self.need, need))

    def is_blocked(self, start: Array, end: Array) -> bool:
        """Return True if the line between two points comes too near to a zone.

        Parameters
        ----------
        start, end : (2,) north and east (m).
        """
        return bool(is_blocked(self.zones, self.need, start[0], start[1], end[0], end[1]))

    def chain_is_blocked(self, start: Array, points: Array) -> bool:
        """Return True if the line from a point through others comes too near to a zone.

        Parameters
        ----------
        start : (2,) north and east (m).
        points : (K, 2) north and east (m), in order.
        """
        return bool(_chain_is_blocked(self.zones, self.need, start, points))

    def way(self, start: Array, goal: Array, *, remember: bool = True) -> Array:
        """Return the way from a point to another: the nodes on it and the goal, (K, 2) in m.

        If there is no way, it leads to the node nearest to the goal that can be reached.

        Parameters
        ----------
        start, goal : (2,) north and east (m).
        remember : True: the way chosen last counts, and this one counts next time.
        """
        if not self.is_blocked(start, goal):
            way: Array = goal[None]
            self._way = way if remember else self._way
            return way
        best = self._shortest(start, goal)
        if not remember:
            return best
        kept = self._shortened(start, goal)
        if kept is None or _length(start, best) < (1.0 - SHORTER) * _length(start, kept):
            kept = best
        self._way = kept
        return kept

    def _shortest(self, start: Array, goal: Array) -> Array:
        """Return the shortest way (Dijkstra 1959)."""
        nodes = self._nodes
        if not len(nodes):
            return start[None]
        if not np.array_equal(goal, self._goal):
            self._goal = goal.copy()
            self._to_goal = _distances(self.zones, self.need, self._lengths, nodes, goal)
        to_goal, first = self._to_goal
        from_start = _seen_from(self.zones, self.need, nodes, start)
        total = from_start + to_goal
        if not np.isfinite(total).any():
            # No way: to the node that can be reached and is nearest to the goal.
            to_start, after = _distances(self.zones, self.need, self._lengths, nodes, start)
            near = np.where(np.isfinite(to_start), np.hypot(*(nodes - goal).T), np.inf)
            k = int(np.argmin(near))
            if not np.isfinite(near[k]) or near[k] >= math.dist(start, goal):
                return start[None]
            back = [k]
            while after[back[-1]] >= 0:
                back.append(int(after[back[-1]]))
            way: Array = nodes[back[::-1]]
            return way
        k = int(np.argmin(total))
        order = [k]
        while first[order[-1]] >= 0:
            order.append(int(first[order[-1]]))
        return np.vstack([nodes[order], goal])

    def _shortened(self, start: Array, goal: Array) -> Array | None:
        """Return the last way, from its farthest point that is seen from the start; None if it is no way any more."""
        last = self._way[:-1]
        if not len(last) or self.is_blocked(last[-1], goal):
            return None
        for k in range(len(last) - 1, -1, -1):
            if not self.is_blocked(start, last[k]):
                return np.vstack([last[k:], goal])
        return None


@jit
def _suits(own: Array, need: Array) -> bool:
    """Return True if every required clearance (Z,) is near enough to a router's own."""
    suits = True
    for z in range(len(own)):
        suits &= 0.8 * own[z] <= need[z] <= own[z] + 0.05
    return suits


def _length(start: Array, way: Array) -> float:
    return math.dist(start, way[0]) + sum(math.dist(a, b) for a, b in itertools.pairwise(way))


def _nodes(zones: Zones, need: Array):  # type: ignore[no-untyped-def]
    """Yield the nodes of all zones."""
    for z in range(len(zones.radius)):
        ring = zones.vertices[zones.first[z] : zones.first[z + 1]]
        reach = float(zones.radius[z] + need[z])
        if len(ring) == 1:
            count = math.ceil(2.0 * math.pi / ARC_RAD)
            for angle in 2.0 * math.pi * np.arange(count) / count:
                yield ring[0] + reach / math.cos(0.5 * ARC_RAD) * np.array([math.cos(angle), math.sin(angle)])
            continue
        along = np.roll(ring, -1, axis=0) - ring
        outward = np.arctan2(along[:, 0], -along[:, 1])  # direction of the normal to starboard: east over north
        for i in range(len(ring)):
            turn = math.remainder(outward[i] - outward[i - 1], 2.0 * math.pi)
            if turn >= 0.0:  # the corner does not reach into the allowed side
                continue
            count = math.ceil(-turn / ARC_RAD)
            for j in range(count):
                angle = outward[i - 1] + turn * (j + 0.5) / count
                size = reach / math.cos(0.5 * turn / count)
                yield ring[i] + size * np.array([math.cos(angle), math.sin(angle)])


@jit
def _visible_lengths(zones: Zones, need: Array, nodes: Array) -> Array:
    """Return the distances (V, V) in m between nodes that see each other; infinite for the others."""
    V = len(nodes)
    out = np.full((V, V), np.inf)
    for i in range(V):
        for j in range(i):
            if not is_blocked(zones, need, nodes[i, 0], nodes[i, 1], nodes[j, 0], nodes[j, 1]):
                out[i, j] = out[j, i] = np.hypot(nodes[i, 0] - nodes[j, 0], nodes[i, 1] - nodes[j, 1])
    return out


@jit
def _seen_from(zones: Zones, need: Array, nodes: Array, point: Array) -> Array:
    """Return the distances (V,) in m of the nodes that are seen from a point; infinite for the others."""
    out = np.full(len(nodes), np.inf)
    for i in range(len(nodes)):
        if not is_blocked(zones, need, point[0], point[1], nodes[i, 0], nodes[i, 1]):
            out[i] = np.hypot(nodes[i, 0] - point[0], nodes[i, 1] - point[1])
    return out


@jit
def _distances(zones: Zones, need: Array, lengths: Array, nodes: Array, goal: Array):  # type: ignore[no-untyped-def]
    """Return the distances (V,) of the nodes from a goal in m, and the next node towards it, -1 for the goal."""
    V = len(nodes)
    out = _seen_from(zones, need, nodes, goal)
    following = np.full(V, -1)
    done = np.zeros(V, dtype=np.bool_)
    for _ in range(V):
        best = -1
        for i in range(V):
            if not done[i] and (best < 0 or out[i] < out[best]):
                best = i
        if np.isinf(out[best]):
            break
        done[best] = True
        for i in range(V):
            if out[best] + lengths[best, i] < out[i]:
                out[i], following[i] = out[best] + lengths[best, i], best
    return out, following


@jit
def _chain_is_blocked(zones: Zones, need: Array, start: Array, points: Array) -> bool:
    """Return True if the line from a point through others is blocked."""
    n, e = start[0], start[1]
    for k in range(len(points)):
        if (k == 0 or n != points[k, 0] or e != points[k, 1]) and is_blocked(
            zones, need, n, e, points[k, 0], points[k, 1]
        ):
            return True
        n, e = points[k, 0], points[k, 1]
    return False


@jit_outlined
def is_blocked(zones: Zones, need: Array, n0: float, e0: float, n1: float, e1: float) -> bool:
    """Return True if the line between two points comes nearer to a zone than the required clearance.

    An end that is too near already lowers the clearance that counts. A zone that an end is in does not count.

    Parameters
    ----------
    zones : zones of the fence.
    need : (Z,) required clearance (m).
    n0, e0, n1, e1 : north and east of both points (m).
    """
    for z in range(len(need)):
        reach = zones.circle[z, 2] + need[z]
        if _from_line(zones.circle[z, 0], zones.circle[z, 1], n0, e0, n1, e1) > reach:
            continue
        least = min(need[z], clearance(zones, z, n0, e0), clearance(zones, z, n1, e1)) - SLACK_M
        if least <= -SLACK_M:
            continue
        least = max(least, 0.0)
        begin, end = zones.first[z], zones.first[z + 1]
        for i in range(begin, end):
            j = i + 1 if i + 1 < end else begin
            a, b = zones.vertices[i, 0], zones.vertices[i, 1]
            c, d = zones.vertices[j, 0], zones.vertices[j, 1]
            if _from_line(a, b, n0, e0, n1, e1) < zones.radius[z] + least:
                return True
            if end - begin > 1:
                if _from_line(n0, e0, a, b, c, d) < least or _from_line(n1, e1, a, b, c, d) < least:
                    return True
                if _crosses(a, b, c, d, n0, e0, n1, e1):
                    return True
    return False


@jit
def _from_line(n: float, e: float, n0: float, e0: float, n1: float, e1: float) -> float:
    """Return the distance (m) of a point from the line between two points."""
    dn, de = n1 - n0, e1 - e0
    square = dn * dn + de * de
    part = min(max(((n - n0) * dn + (e - e0) * de) / square, 0.0), 1.0) if square > 0.0 else 0.0
    return float(np.hypot(n - n0 - part * dn, e - e0 - part * de))


@jit
def _crosses(a: float, b: float, c: float, d: float, n0: float, e0: float, n1: float, e1: float) -> bool:
    """Return True if the line from (a, b) to (c, d) crosses that from (n0, e0) to (n1, e1)."""
    first = (c - a) * (e0 - b) - (d - b) * (n0 - a)
    second = (c - a) * (e1 - b) - (d - b) * (n1 - a)
    third = (n1 - n0) * (b - e0) - (e1 - e0) * (a - n0)
    fourth = (n1 - n0) * (d - e0) - (e1 - e0) * (c - n0)
    return first * second < 0.0 and third * fourth < 0.0
