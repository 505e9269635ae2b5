"""Shortest way round the zones: a visibility graph of their grown corners (Lozano-Perez & Wesley 1979).

The corners of all zones, moved outwards by the required clearance, are the nodes. Two nodes are neighbours if the line
between them keeps the clearance from every zone. Neighbours are searched where a way may lead: among 60 zones those of
all nodes would take longer than a control cycle. A disc, and a corner that reaches into the allowed side, has nodes on
an arc around it. The way that was chosen last is kept unless another one is shorter by the share ``SHORTER``: otherwise
the vehicle could change its mind with every estimate.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.geofence.zones import Zones, are_clear, nearest
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


class Search(NamedTuple):
    """Shortest ways from one point to the nodes, as far as they are known."""

    length: Array  # (V,) of the shortest way that is known (m)
    before: npt.NDArray[np.int64]  # (V,) node before each one on it, -1 for the point itself
    settled: npt.NDArray[np.bool_]  # (V,) True where no way is shorter

    def chain(self, k: int) -> list[int]:
        """Return the nodes from node k back to the first one behind the point.

        Parameters
        ----------
        k : node that a way leads to.
        """
        nodes = [k]
        while self.before[nodes[-1]] >= 0:
            nodes.append(int(self.before[nodes[-1]]))
        return nodes


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
        self.nodes = nodes[are_clear(zones, self.need - SLACK_M, nodes)]
        """(V, 2) points at which a way may turn, north and east (m)."""
        # (V, V) between nodes that see each other (m), else infinite; NaN where no search has needed it yet
        self._lengths = np.full((len(self.nodes), len(self.nodes)), np.nan)
        self._way = np.empty((0, 2))
        self._goal = np.full(2, np.nan)  # of the search that is kept, as a point keeps it for many cycles
        self._from_goal = Search(np.empty(0), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.bool_))

    def serves(self, need: Array) -> bool:
        """Return True if the ways suit other required clearances: at most 5 cm too near, and not a quarter too far.

        Parameters
        ----------
        need : (Z,) required clearance (m).
        """
        return bool(((0.8 * self.need <= need) & (need <= self.need + 0.05)).all())

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
        chain = np.vstack([start, points])
        moves = (chain[1:] != chain[:-1]).any(axis=1)
        moves[:1] = True
        return any(self.is_blocked(*chain[k : k + 2]) for k in np.flatnonzero(moves))

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
        if kept is None or length_m(np.vstack([start, best])) < (1.0 - SHORTER) * length_m(np.vstack([start, kept])):
            kept = best
        self._way = kept
        return kept

    def _shortest(self, start: Array, goal: Array) -> Array:
        """Return the shortest way."""
        nodes = self.nodes
        if not len(nodes):
            return start[None]
        if not np.array_equal(goal, self._goal):
            self._goal = goal.copy()
            self._from_goal = self._begin(goal)
        k = self._search(self._from_goal, start)
        if k >= 0:
            return np.vstack([nodes[self._from_goal.chain(k)], goal])
        # No way: to the node that can be reached and is nearest to the goal.
        from_start = self._begin(start)
        self._search(from_start, goal)  # to its end: the goal is not reached
        near = np.where(np.isfinite(from_start.length), np.hypot(*(nodes - goal).T), np.inf)
        k = int(np.argmin(near))
        if not np.isfinite(near[k]) or near[k] >= math.dist(start, goal):
            return start[None]
        way: Array = nodes[from_start.chain(k)[::-1]]
        return way

    def _begin(self, point: Array) -> Search:
        """Return a search from a point that has looked at the nodes which the point sees."""
        length = _seen_from(self.zones, self.need, self.nodes, point)
        return Search(length, np.full(len(length), -1), np.zeros(len(length), dtype=np.bool_))

    def _search(self, of: Search, to: Array) -> int:
        """Continue a search until the shortest way to a point is known; return the last node before it, -1 for no way.

        The nodes are settled in the order of their way's length and the straight distance to the point (A*: Hart,
        Nilsson & Raphael 1968). What is settled is right for any other point, too.
        """
        seen, straight = _seen_from(self.zones, self.need, self.nodes, to), np.hypot(*(self.nodes - to).T)
        while True:
            total = np.where(of.settled, np.inf, of.length + straight)
            arriving = np.where(of.settled, of.length + seen, np.inf)
            best, last = int(np.argmin(total)), int(np.argmin(arriving))
            if total[best] >= arriving[last]:
                return last if np.isfinite(arriving[last]) else -1
            of.settled[best] = True
            unknown, node = np.isnan(self._lengths[best]), self.nodes[best]
            found = _seen_from(self.zones, self.need, self.nodes[unknown], node)
            self._lengths[best, unknown] = self._lengths[unknown, best] = found
            way = of.length[best] + self._lengths[best]
            shorter = way < of.length
            of.length[shorter], of.before[shorter] = way[shorter], best

    def _shortened(self, start: Array, goal: Array) -> Array | None:
        """Return the last way, from its farthest point that is seen from the start; None if it is no way any more."""
        last = self._way[:-1]
        if not len(last) or self.is_blocked(last[-1], goal):
            return None
        for k in range(len(last) - 1, -1, -1):
            if not self.is_blocked(start, last[k]):
                return np.vstack([last[k:], goal])
        return None


def length_m(way: Array) -> float:
    """Return the length (m) of a way.

    Parameters
    ----------
    way : (P, 2) north and east of its points (m).
    """
    return float(np.hypot(*np.diff(way, axis=0).T).sum())


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
def _seen_from(zones: Zones, need: Array, nodes: Array, point: Array) -> Array:
    """Return the distances (V,) in m of the nodes that are seen from a point; infinite for the others."""
    out = np.full(len(nodes), np.inf)
    for i in range(len(nodes)):
        if not is_blocked(zones, need, point[0], point[1], nodes[i, 0], nodes[i, 1]):
            out[i] = np.hypot(nodes[i, 0] - point[0], nodes[i, 1] - point[1])
    return out


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
    length = np.hypot(n1 - n0, e1 - e0)
    tn, te = ((n1 - n0) / length, (e1 - e0) / length) if length > 0.0 else (0.0, 0.0)
    for z in range(len(need)):
        if _from_line(zones.circle[z, 0], zones.circle[z, 1], n0, e0, n1, e1) > zones.circle[z, 2] + need[z]:
            continue
        reach, least = zones.radius[z] + need[z], np.nan
        begin, end = zones.first[z], zones.first[z + 1]
        for i in range(begin, end):
            j = i + 1 if i + 1 < end else begin
            a, b = zones.vertices[i, 0], zones.vertices[i, 1]
            c, d = zones.vertices[j, 0], zones.vertices[j, 1]
            along, across = (a - n0) * tn + (b - e0) * te, (b - e0) * tn - (a - n0) * te
            along_j, across_j = (c - n0) * tn + (d - e0) * te, (d - e0) * tn - (c - n0) * te
            if max(along, along_j) < -reach or min(along, along_j) > length + reach:
                continue  # most edges of a long ring are far from the line
            if max(across, across_j) < -reach or min(across, across_j) > reach:
                continue
            if np.isnan(least):
                least = min(need[z], nearest(zones, z, n0, e0)[0], nearest(zones, z, n1, e1)[0]) - SLACK_M
                if least <= -SLACK_M:
                    break
                least = max(least, 0.0)
            if _from_line(a, b, n0, e0, n1, e1) < zones.radius[z] + least:
                return True
            if end - begin > 1:
                if _from_line(n0, e0, a, b, c, d) < least or _from_line(n1, e1, a, b, c, d) < least:
                    return True
                # the lines cross if the ends of each lie on both sides of the other
                first, second = (c - a) * (e0 - b) - (d - b) * (n0 - a), (c - a) * (e1 - b) - (d - b) * (n1 - a)
                third = (n1 - n0) * (b - e0) - (e1 - e0) * (a - n0)
                fourth = (n1 - n0) * (d - e0) - (e1 - e0) * (c - n0)
                if first * second < 0.0 and third * fourth < 0.0:
                    return True
    return False


@jit
def _from_line(n: float, e: float, n0: float, e0: float, n1: float, e1: float) -> float:
    """Return the distance (m) of a point from the line between two points."""
    dn, de = n1 - n0, e1 - e0
    square = dn * dn + de * de
    part = min(max(((n - n0) * dn + (e - e0) * de) / square, 0.0), 1.0) if square > 0.0 else 0.0
    return float(np.hypot(n - n0 - part * dn, e - e0 - part * de))
