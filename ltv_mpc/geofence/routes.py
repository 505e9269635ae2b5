"""Routes of the reference: they lead round the zones of a fence, and round the obstacles that hardly move.

An obstacle at anchor blocks a path as a zone does: a target behind it would wait there for a vehicle that stands in
front of it. An obstacle that moves will be elsewhere when the vehicle comes, so the reference ignores it, and only the
rows of the QP keep clear of it.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.geofence.allowed_path import DividedTable, allowed_path, divided
from ltv_mpc.geofence.route import Router
from ltv_mpc.geofence.zones import Zones
from ltv_mpc.messages import Array
from ltv_mpc.references.schedule import Schedule

NO_ZONES = Zones(np.empty((0, 2)), np.zeros(1, dtype=np.int64), np.empty(0), np.empty(0), np.empty((0, 3)))
"""Zones without a fence."""

MOVED = 0.1
"""Share of its required clearance by which an obstacle may move before the ways are computed again."""


class Routes:
    """Shortest ways round zones and standing obstacles, and the part of a path that is allowed."""

    def __init__(self) -> None:
        """Begin with nothing in the way."""
        self.router: Router | None = None
        """Shortest ways at the required clearances of this cycle; None if nothing is in the way."""
        self._at_margins: Router | None = None
        self._zones, self._need = NO_ZONES, np.empty(0)
        self._standing = np.empty((0, 3))
        self._divided: tuple[Schedule, DividedTable] | None = None  # last path, and its table in small steps

    def set_zones(self, zones: Zones, need: Array) -> None:
        """Lead round other zones.

        Parameters
        ----------
        zones : zones of the fence.
        need : (Z,) required clearance at the stated margins (m).
        """
        self._zones, self._need = zones, need.copy()
        self._restart()

    def set_standing(self, standing: Array) -> bool:
        """Lead round other standing obstacles; return True if they differ from those before.

        Parameters
        ----------
        standing : (S, 3) north, east and required clearance of each (m), in a constant order.
        """
        before = self._standing
        if len(before) == len(standing) and (np.abs(standing - before) <= MOVED * before[:, 2:]).all():
            return False
        self._standing = standing
        self._restart()
        return True

    def require(self, need: Array) -> None:
        """Keep other required clearances from the zones, in this cycle.

        Parameters
        ----------
        need : (Z,) required clearance (m).
        """
        zones, required = self._with_standing(need)
        if self.router is None or not self.router.serves(required):
            self.router = Router(zones, required)

    def allowed_path(self, schedule: Schedule) -> tuple[Schedule, float]:
        """Return the part of a schedule outside zones, margins and obstacles, and the length that is left out (m).

        Parameters
        ----------
        schedule : motion of the target.
        """
        if self._at_margins is None:
            return schedule, 0.0
        if self._divided is None or self._divided[0] is not schedule:
            self._divided = schedule, divided(schedule.table)
        return allowed_path(schedule, self._at_margins, self._divided[1])

    def _restart(self) -> None:
        zones, need = self._with_standing(self._need)
        self.router = self._at_margins = Router(zones, need) if len(need) else None

    def _with_standing(self, need: Array) -> tuple[Zones, Array]:
        """Return the zones and their required clearances, with a zone of no size for each standing obstacle."""
        zones, standing = self._zones, self._standing
        if not len(standing):
            return zones, need
        none, last = np.zeros(len(standing)), zones.first[-1]
        together = Zones(
            vertices=np.vstack([zones.vertices, standing[:, :2]]),
            first=np.concatenate([zones.first, last + 1 + np.arange(len(standing))]),
            radius=np.concatenate([zones.radius, none]),
            margin=np.concatenate([zones.margin, none]),
            circle=np.vstack([zones.circle, np.column_stack([standing[:, :2], none])]),
        )
        return together, np.concatenate([need, standing[:, 2]])
