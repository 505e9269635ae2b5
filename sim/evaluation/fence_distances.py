"""Distance of the true hull from the zones of the fence in force. Positions are absolute: drift of the estimate counts.

The fence is that of the run until the controller publishes another one.
"""

from __future__ import annotations

from array import array

import numpy as np

from ltv_mpc.geofence.fence import Fence
from ltv_mpc.messages import Array, FenceInForce, Plan, Truth, ZoneInForce
from ltv_mpc.vehicle.parameters import Vehicle
from sim.evaluation.summary import ZoneFigures


class FenceDistances:
    """True positions of a run, fences in force meanwhile, plans that keep too little. The hull counts as a circle."""

    def __init__(self, vehicle: Vehicle, fence: Fence | None) -> None:
        self._hull_m = 0.0 if vehicle.hull is None else vehicle.hull.radius_m
        self._zones: tuple[ZoneInForce, ...] = () if fence is None else tuple(fence.zones())
        self._truth = array("d")  # t, north, east; since these zones are in force
        self._figures: dict[str, ZoneFigures] = {}  # of the time before
        self.exceeded = 0
        """Number of plans that lack more than 1 cm of a required clearance."""

    def add_fence(self, fence: FenceInForce, *_: int) -> None:
        """Add the fence that the controller publishes."""
        if [_key(zone) for zone in fence.zones] != [_key(zone) for zone in self._zones]:
            self._figures = {figures.zone: figures for figures in self.figures()}
            self._truth = self._truth[-3:] if self._zones else array("d")  # none is kept while there is no fence
            self._zones = fence.zones

    def add_truth(self, truth: Truth) -> None:
        """Add the true position, from t = 0 on."""
        if self._zones and truth.t_ns >= 0:
            self._truth.extend((truth.t_ns, *truth.position_m[:2]))

    def add_plan(self, plan: Plan) -> None:
        """Count a plan that lacks more than 1 cm of a required clearance."""
        self.exceeded += plan.fence is not None and plan.fence.exceeded > 0

    def figures(self) -> tuple[ZoneFigures, ...]:
        """Return the figures of each zone that was in force, the times of zones of one name added; none without any."""
        if not self._zones or not self._truth:
            return tuple(self._figures.values())
        rows, margins = np.array(self._truth).reshape(-1, 3), [zone.margin_m for zone in self._zones]
        clearance = np.column_stack([_clearance(zone, rows[:, 1:]) for zone in self._zones]) - self._hull_m  # (K, Z)
        length_s = np.append(np.diff(rows[:, 0]), 0.0)[:, None] * 1e-9
        in_margin = (length_s * (clearance < margins)).sum(axis=0)
        inside = (length_s * (clearance < 0.0)).sum(axis=0)
        out = dict(self._figures)
        figures = zip(self._zones, clearance.min(axis=0).tolist(), in_margin.tolist(), inside.tolist(), strict=True)
        for zone, least, margin_s, inside_s in figures:
            before = out.get(zone.label)
            out[zone.label] = ZoneFigures(
                zone=zone.label,
                least_clearance_m=least if before is None else min(least, before.least_clearance_m),
                in_margin_s=margin_s + (0.0 if before is None else before.in_margin_s),
                inside_s=inside_s + (0.0 if before is None else before.inside_s),
            )
        return tuple(out.values())


def _key(zone: ZoneInForce) -> tuple[object, ...]:
    return zone.label, zone.keep_in, zone.vertices_m.tobytes(), zone.radius_m, zone.margin_m


def _clearance(zone: ZoneInForce, points: Array) -> Array:
    """Return the clearance (K,) of points (K, 2) from a zone (m).

    The controller's own geometry is compiled, which the process that needs this at the end of a run is not.
    """
    import shapely  # takes a tenth of a second, and only a fence needs it

    ring = zone.vertices_m
    area = shapely.Polygon(ring) if len(ring) > 2 else shapely.MultiPoint(ring)  # any publisher may give fewer
    shapely.prepare(area)
    distance = shapely.distance(area.exterior if len(ring) > 2 else area, shapely.points(points))
    allowed = shapely.contains_xy(area, *points.T) == zone.keep_in
    clearance: Array = np.where(allowed, distance, -distance) - zone.radius_m
    return clearance
