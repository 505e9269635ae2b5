"""Distances from the reference: positions wait until a plan gives the reference at their time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

from ltv_mpc.messages import Plan
from services.reporting.plots.table import Table

Position: TypeAlias = tuple[float, float, float | None]
"""North, east and depth (m)."""

MAX_WAITING = 1000
"""Positions that wait at most: bounds the memory if no plans arrive."""


class Distances:
    """Calculator of the rows of the tables ``distance`` (of the estimate) and ``true_distance`` (of the vehicle)."""

    def __init__(self, tables: dict[str, Table], seconds: Callable[[int], float]) -> None:
        """``seconds`` converts a vehicle time (ns) to the time axis."""
        self.newest_m: dict[str, float] = {}
        """Newest distance (m), by table; without a known truth there is none of the vehicle."""
        self._tables = tables
        self._seconds = seconds
        self._targets: list[tuple[int, float, float]] = []  # t_ns, north, east of the last two plans
        self._waiting: list[tuple[str, int, Position]] = []  # positions that wait for the next target

    def add_position(self, table: str, t_ns: int, position: Position) -> None:
        """Queue a position (m) until a plan with a later target gives the reference at that time."""
        self._waiting.append((table, t_ns, position))
        del self._waiting[:-MAX_WAITING]

    def add_plan(self, plan: Plan) -> None:
        """Add the target of a plan, and the distances of the positions that waited for it."""
        if plan.reference_m is None:
            return
        t_ns = int(plan.t_ns[0])
        if not self._targets:  # there was no reference before
            self._waiting = [one for one in self._waiting if one[1] >= plan.cycle_t_ns]
        self._tables["reference"].add(self._seconds(t_ns), *plan.reference_m, plan.reference_depth_m)
        last = self._targets[-1] if self._targets and plan.progress is not None else (t_ns, *plan.reference_m)
        self._targets = [last, (t_ns, *plan.reference_m)]
        waiting, self._waiting = self._waiting, []
        for table, then_ns, (north_m, east_m, depth_m) in waiting:
            if then_ns > t_ns and plan.progress is not None:
                self._waiting.append((table, then_ns, (north_m, east_m, depth_m)))
                continue
            self.newest_m[table] = self._distance_m(then_ns, north_m, east_m)
            self._tables[table].add(self._seconds(then_ns), self.newest_m[table], depth_m)

    def _distance_m(self, t_ns: int, north_m: float, east_m: float) -> float:
        """Return the distance from the reference, interpolated linearly between the targets of two plans."""
        (t0, north0, east0), (t1, north1, east1) = self._targets
        s = min(max((t_ns - t0) / (t1 - t0), 0.0), 1.0) if t1 > t0 else 1.0
        return math.hypot(north_m - north0 - s * (north1 - north0), east_m - east0 - s * (east1 - east0))
