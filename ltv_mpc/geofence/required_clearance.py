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
from ltv_mpc.geofence.zones import Zones, clearances, nearest
from ltv_mpc.messages import Array

ROOM = 0.5
"""Room that the vehicle keeps between zones that ask for more than there is, in radii of the hull, to either side."""

SLACK = 0.1
"""Clearance that such a zone asks for beyond what there is, in radii of the hull: rounding must not lower it."""


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
    asked = hull_m + np.maximum(zones.margin, SD_FACTOR * sd_m) + error_m  # by each zone where it is alone
    now = clearances(zones, np.array([[north, east]]))[0]
    exits[now >= 0.0, 0] = 0.0
    for z in np.flatnonzero((now < 0.0) & (exits[:, 0] == 0.0)).tolist():
        _, mn, me, qn, qe = nearest(zones, z, north, east)
        exits[z] = 1.0, mn, me, mn * qn + me * qe
    lacks = now < asked
    lacking = int(lacks.sum())
    need_before, need[:] = need.copy(), asked
    if lacking > 1:
        margin_m = hull_m + zones.margin
        least = margin_m if (now < margin_m).sum() < 2 else hull_m * (1.0 + SLACK)
        kept = np.minimum(np.maximum(need_before, now - ROOM * hull_m), now + SLACK * hull_m)
        need[lacks] = np.minimum(asked, np.maximum(kept, least))[lacks]
    return lacking
