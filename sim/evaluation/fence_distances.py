"""Distance of the true hull from the zones of the fence in force. Positions are absolute: drift of the estimate counts.

The fence is that of the run until the controller publishes another one.
"""

from __future__ import annotations

import math
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
        zones = () if fence is None else tuple(fence.zones())
        # Zones in force one after the other, and the true positions meanwhile: t, north, east.
        self._times: list[tuple[tuple[ZoneInForce, ...], array[float]]] = [(zones, array("d"))]
        self.exceeded = 0
        """Number of plans that lack more than 1 cm of a required clearance."""

    def add_fence(self, fence: FenceInForce, *_: int) -> None:
        """Add the fence that the controller publishes."""
        zones, positions = self._times[-1]
        if [_key(zone) for zone in fence.zones] != [_key(zone) for zone in zones]:
            self._times.append((fence.zones, positions[-3:] if zones else array("d")))

    def add_truth(self, truth: Truth) -> None:
        """Add the true position, from t = 0 on; none is kept while there is no fence."""
        zones, positions = self._times[-1]
        if zones and truth.t_ns >= 0:
            positions.extend((truth.t_ns, *truth.position_m[:2]))

    def add_plan(self, plan: Plan) -> None:
        """Count a plan that lacks more than 1 cm of a required clearance."""
        self.exceeded += plan.fence is not None and plan.fence.exceeded > 0

    def figures(self) -> tuple[ZoneFigures, ...]:
        """Return the figures of each zone that was in force, the times of zones of one name added; none without any."""
        found: dict[str, ZoneFigures] = {}
        for zones, positions in self._times:
            rows = np.array(positions).reshape(-1, 3)
            length_s = np.append(np.diff(rows[:, 0]), 0.0) * 1e-9
            for zone in zones if len(rows) else ():
                clearance = _clearance(zone, rows[:, 1:]) - self._hull_m
                before = found.get(zone.label) or ZoneFigures(
                    zone=zone.label, least_clearance_m=math.inf, in_margin_s=0.0, inside_s=0.0
                )
                found[zone.label] = ZoneFigures(
                    zone=zone.label,
                    least_clearance_m=min(float(clearance.min()), before.least_clearance_m),
                    in_margin_s=before.in_margin_s + float(length_s[clearance < zone.margin_m].sum()),
                    inside_s=before.inside_s + float(length_s[clearance < 0.0].sum()),
                )
        return tuple(found.values())


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
