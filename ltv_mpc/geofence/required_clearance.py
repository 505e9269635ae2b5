"""Required clearance of the vehicle's origin from each zone, and the exit of a zone that the vehicle is in.

    c = hull + max(margin, k sd) + e

with the standard deviation sd of the position at the first knot, k = ``SD_FACTOR``, and the way e by which the model's
recent error carries the vehicle past the point where it would stop or turn (``control/fencing.py``).

Two zones that ask for more than there is between them would cancel: a vehicle that lacks the clearance of both could
drift into one of them at no cost. So each of them then asks for no more than the vehicle has: what it asked for in the
cycle before, but at most ``SLACK`` more than the clearance now, and at least ``ROOM`` less. It asks for hull + margin
at least, or for the hull alone if the vehicle lacks hull + margin of two zones.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.geofence.obstacles import SD_FACTOR
from ltv_mpc.geofence.zones import Zones, nearest
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

ROOM = 0.5
"""Room that the vehicle keeps between zones that ask for more than there is, in radii of the hull, to either side."""

SLACK = 0.1
"""Clearance that such a zone asks for beyond what there is, in radii of the hull: rounding must not lower it."""


@jit
def update_required(
    zones: Zones, north: float, east: float, hull_m: float, sd_m: float, need: Array, exits: Array, error_m: float = 0.0
) -> int:
    """Update the required clearance of each zone, and its exit if the vehicle has entered it.

    Parameters
    ----------
    zones : zones of the fence.
    north, east : position of the vehicle (m).
    hull_m : radius of its hull (m).
    sd_m : standard deviation of the position (m).
    need : (Z,) required clearance (m) in the cycle before; overwritten.
    exits : (Z, 4) as ``half_planes`` takes them. Those of zones that the vehicle was in before stay, and those of zones
        that it is not in are cleared.
    error_m : way by which the model's error carries the vehicle too far (m).

    Returns
    -------
    Number of zones that ask for more than the vehicle has, before any asks for less.
    """
    Z = len(zones.radius)
    now = np.full(Z, np.inf)  # clearances, where they may be too small
    lacking = lacking_margin = 0
    for z in range(Z):
        n, e, radius = zones.circle[z]
        if np.hypot(north - n, east - e) - radius > _asked(zones, z, hull_m, sd_m, error_m):
            exits[z, 0] = 0.0
            continue
        now[z], mn, me, qn, qe = nearest(zones, z, north, east)
        if now[z] >= 0.0:
            exits[z, 0] = 0.0
        elif exits[z, 0] == 0.0:
            exits[z, 0], exits[z, 1], exits[z, 2], exits[z, 3] = 1.0, mn, me, mn * qn + me * qe
        lacking += now[z] < _asked(zones, z, hull_m, sd_m, error_m)
        lacking_margin += now[z] < hull_m + zones.margin[z]
    for z in range(Z):
        asked = _asked(zones, z, hull_m, sd_m, error_m)
        if lacking > 1 and now[z] < asked:
            least = hull_m + zones.margin[z] if lacking_margin < 2 else hull_m * (1.0 + SLACK)
            kept = min(max(need[z], now[z] - ROOM * hull_m), now[z] + SLACK * hull_m)
            asked = min(asked, max(kept, least))
        need[z] = asked
    return lacking


@jit
def _asked(zones: Zones, z: int, hull_m: float, sd_m: float, error_m: float) -> float:
    """Return what a zone asks for where it is alone (m)."""
    return float(hull_m + max(zones.margin[z], SD_FACTOR * sd_m) + error_m)
