"""Targets of a horizon where they cannot stay: behind a zone, or out of reach.

A target behind a zone would pull the vehicle against it. So where the line through the targets is blocked, they move
along the shortest way round the zones (``geofence/route.py``), no faster than the vehicle can follow:

    target at knot k = point of the way at the distance  min(distance of the wanted target, V t_k + lead)

with the speed over ground V that the vehicle reaches in the current, and a lead of ``LEAD`` lengths.

Of a target out of reach only the direction counts, but the duals of the limits would grow with its distance. So it
moves nearer, to ``FAR`` times the way that the vehicle can make within the horizon.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.control.scaling import Scales
from ltv_mpc.control.terminal_check import closing_speed
from ltv_mpc.geofence.route import Router
from ltv_mpc.messages import Array

LEAD = 0.5
"""Lead of the target, in lengths L of the vehicle (scaling.py)."""

MIN_SPEED = 0.2
"""Speed of the target, at least, over the top speed."""

FAR = 2.0
"""Distance of the farthest target, in ways that the vehicle can make within the horizon."""


def bring_near(position: Array, current: Array, target: Array, horizon_s: float, top_mps: float) -> None:
    """Bring targets that are out of reach nearer.

    Parameters
    ----------
    position, current, target : as in ``lead_round``.
    horizon_s : length of the horizon (s).
    top_mps : top speed of the vehicle through the water (m/s).
    """
    way = target[:-1, :2] - position
    distance = np.hypot(way[:, 0], way[:, 1])
    reach = FAR * horizon_s * (top_mps + math.hypot(current[0], current[1]))
    if distance.max() > reach:
        target[:-1, :2] = position + way * (reach / np.maximum(distance, reach))[:, None]


def lead_round(router: Router, position: Array, current: Array, target: Array, times_s: Array, scales: Scales) -> bool:
    """Lead the targets of a horizon round the zones.

    Parameters
    ----------
    router : shortest ways round the zones.
    position : (2,) of the vehicle at the first knot (m).
    current : (2,) velocity of the water there (m/s).
    target : (N+1, 3) as in ``ocp/terms.py``; positions and velocity are overwritten.
    times_s : (N+1,) times of the knots after the first one (s).
    scales : length and top speed of the vehicle.

    Returns
    -------
    True if the way leads to the last target; False if there is no way to it, and the targets lead as near as possible.
    """
    corners, lengths, arrives = [position.copy()], [0.0], True
    wanted = np.empty(len(target) - 1)  # distance of each target along the way (m)
    others = (target[1:-1, :2] != target[:-2, :2]).any(axis=1)
    for k in (0, *(np.flatnonzero(others) + 1)):
        for corner in router.way(corners[-1], target[k, :2].copy(), remember=k == 0):
            lengths.append(lengths[-1] + math.dist(corners[-1], corner))
            corners.append(corner)
        arrives = bool((corners[-1] == target[k, :2]).all())
        wanted[k:] = lengths[-1]
    way, along = np.array(corners), np.array(lengths)
    speed = _speed_mps(way, current, scales.speed_mps)
    reach = np.minimum(wanted, speed * times_s[1:] + LEAD * scales.length_m)
    for i in range(2):
        target[:-1, i] = np.interp(reach, along, way[:, i])
    if reach[-1] < wanted[-1]:
        leg = min(int(np.searchsorted(along, reach[-1], side="right")), len(way) - 1)
        step = way[leg] - way[leg - 1]
        target[-1, :2] = speed * step / max(float(np.hypot(*step)), 1e-9)
    return arrives


def _speed_mps(way: Array, current: Array, top_mps: float) -> float:
    """Return the speed over ground with which the vehicle can follow the first leg of a way (m/s)."""
    legs = np.diff(way, axis=0)
    legs = legs[np.hypot(*legs.T) > 1e-6]
    if not len(legs):
        return MIN_SPEED * top_mps
    en, ee = legs[0] / np.hypot(*legs[0])
    return max(closing_speed(en, ee, -current[0], -current[1], top_mps), MIN_SPEED * top_mps)
