"""Sides on which the vehicle passes the zones, and exits of the zones it is in.

A predicted track that crosses a keep-out zone leaves its chord, from the last point before the zone to the first point
behind it. The zone's side is port (-1) or starboard (+1) of that chord: the points inside are pushed to the half-plane
that touches the zone on this side. At first the side is the one with the shorter way. It is kept until the exact cost
of the other one has been ``CHEAPER`` lower for ``PATIENCE_NS``: a free choice flips in a concave trap.

If the vehicle itself is in a zone, all points are asked for the half-plane of the exit that was nearest when it
entered, until it is out: a free choice crosses the zone.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.geofence.half_planes import ALL, INSIDE, NONE
from ltv_mpc.geofence.zones import Zones, clearance, nearest, support
from ltv_mpc.messages import Array, Pair

CHEAPER = 0.05
"""Share by which the cost of the other side must be lower."""

PATIENCE_NS = 1_000_000_000
"""Time for which it must be lower (ns)."""


class SideMemory:
    """Side of every zone, kept from cycle to cycle."""

    def __init__(self, zones: Zones) -> None:
        """Begin without sides.

        Parameters
        ----------
        zones : zones of the fence.
        """
        self._zones = zones
        Z = len(zones.radius)
        self.side = np.zeros(Z, dtype=np.int64)
        """(Z,) side of each zone: -1 port, 1 starboard, 0 not chosen."""
        self.pushes = np.zeros((Z, 4))
        """(Z, 4) half-plane by zone: for which points (``NONE``, ``INSIDE``, ``ALL``), m north, m east, offset (m)."""
        self._cheaper_since_ns: list[int | None] = [None] * Z

    def update(self, position: Pair, points: Array) -> None:
        """Choose the half-planes of this cycle.

        Parameters
        ----------
        position : north and east of the vehicle (m).
        points : (P, 2) north and east of the predicted track (m), the first one near the vehicle.
        """
        for z in range(len(self.side)):
            distance, mn, me, qn, qe = nearest(self._zones, z, *position)
            if distance < 0.0:
                if self.pushes[z, 0] != ALL:
                    self.pushes[z] = ALL, mn, me, mn * qn + me * qe
            else:
                self.pushes[z] = self._push(z, position, points)

    def consider(self, z: int, cost: float, other_cost: float, t_ns: int) -> bool:
        """Change the side of a zone if the other one has been cheaper for long enough; return True if it changed.

        Parameters
        ----------
        z : number of the zone.
        cost, other_cost : exact costs of the tracks on the zone's side and on the other one.
        t_ns : now, vehicle time (ns).
        """
        since_ns = self._cheaper_since_ns[z]
        if not other_cost < (1.0 - CHEAPER) * cost:
            self._cheaper_since_ns[z] = None
        elif since_ns is None:
            self._cheaper_since_ns[z] = t_ns
        elif t_ns - since_ns >= PATIENCE_NS:
            self.side[z] *= -1
            self._cheaper_since_ns[z] = None
            return True
        return False

    def _push(self, z: int, position: Pair, points: Array) -> tuple[float, float, float, float]:
        """Return the half-plane of a zone for the points inside; the side is forgotten where none is inside."""
        zones = self._zones
        inside = [k for k, point in enumerate(points) if clearance(zones, z, *point) < 0.0]
        if not inside or np.isinf(zones.circle[z, 2]):  # a keep-in zone has no sides
            self.side[z] = 0
            return NONE, 0.0, 0.0, 0.0
        before = points[inside[0] - 1] if inside[0] > 0 else np.array(position)
        after = points[min(inside[-1] + 1, len(points) - 1)]
        way = after - before
        length = float(np.hypot(*way))
        if length == 0.0:
            return NONE, 0.0, 0.0, 0.0
        starboard = np.array([-way[1], way[0]]) / length
        if self.side[z] == 0:
            ways = [support(zones, z, *(side * starboard)) - side * starboard @ before for side in (1, -1)]
            self.side[z] = 1 if ways[0] <= ways[1] else -1
        mn, me = self.side[z] * starboard
        return INSIDE, float(mn), float(me), support(zones, z, mn, me)
