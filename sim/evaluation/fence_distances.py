"""Distance of the true hull from the zones of a run's fence. Positions are absolute: drift of the estimate counts."""

from __future__ import annotations

import numpy as np

from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.zones import clearances, pack_zones
from ltv_mpc.messages import Truth
from ltv_mpc.vehicle.parameters import Vehicle
from sim.evaluation.summary import ZoneFigures


class FenceDistances:
    """True positions of a run with a fence. The hull counts as the circle around it."""

    def __init__(self, vehicle: Vehicle, fence: Fence | None) -> None:
        self._fence = fence
        self._hull_m = 0.0 if vehicle.hull is None else vehicle.hull.radius_m
        self._truth: list[tuple[int, float, float]] = []

    def add_truth(self, truth: Truth) -> None:
        """Add the true position, from t = 0 on."""
        if self._fence is not None and truth.t_ns >= 0:
            self._truth.append((truth.t_ns, truth.position_m[0], truth.position_m[1]))

    def figures(self) -> tuple[ZoneFigures, ...]:
        """Return the figures of each zone; none without a fence or a truth."""
        if self._fence is None or not self._truth:
            return ()
        rows = np.array(self._truth)
        clearance = clearances(pack_zones(self._fence), np.ascontiguousarray(rows[:, 1:])) - self._hull_m  # (K, Z)
        length_s = np.append(np.diff(rows[:, 0]), 0.0)[:, None] * 1e-9
        zones = list(self._fence.zones())
        in_margin = (length_s * (clearance < [zone.margin_m for zone in zones])).sum(axis=0)
        inside = (length_s * (clearance < 0.0)).sum(axis=0)
        figures = zip(zones, clearance.min(axis=0).tolist(), in_margin.tolist(), inside.tolist(), strict=True)
        return tuple(
            ZoneFigures(zone=zone.label, least_clearance_m=least, in_margin_s=margin_s, inside_s=inside_s)
            for zone, least, margin_s, inside_s in figures
        )
