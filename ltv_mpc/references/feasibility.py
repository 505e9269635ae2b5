"""What is said where a vehicle cannot do what a reference asks for."""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.references.limits import SHARE, Limits
from ltv_mpc.references.path import Path
from ltv_mpc.references.schedule import along, fastest
from ltv_mpc.vehicle.parameters import Vehicle

SAME = 0.99
"""A speed that is this share of the one wanted is that one."""


def path_notes(path: Path, speed_mps: float, limits: Limits, descent_rate_mps: float) -> list[str]:
    """Sentences about a path that is to be followed at ``speed_mps``, worst first."""
    said = []
    straight = min(speed_mps, limits.cruise_mps)
    if limits.cruise_mps < SAME * speed_mps:
        said.append(
            f"speed_mps = {speed_mps:g} is slowed down to {limits.cruise_mps:.2f} m/s, which {SHARE:.0%} of the thrust "
            f"holds in still water; all of it holds {limits.top_mps:.2f} m/s"
        )
    most = fastest(path, limits, descent_rate_mps)
    corner, bend = path.turn > 0.0, (path.turn == 0.0) & (path.curvature > 0.0)
    if corner.any() and most[corner].min() < SAME * straight:
        # a corner of the path is a run of pieces; its first one begins where the piece before it is another's
        corners = int(np.count_nonzero(corner & ~np.concatenate([[False], corner[:-1]])))
        sharpest = path.turn[corner].max()
        said.append(
            f"{_count(corners, 'corner')} of up to {math.degrees(sharpest):.0f} degrees: slowed down to "
            f"{most[corner].min():.2f} m/s, for the vehicle turns at {limits.yaw_radps:.2f} rad/s at most and needs "
            f"{float(limits.turning_s(sharpest)):.1f} s for it"
        )
    stops = path.stop[path.stop > 0.0]
    if len(stops):
        said.append(
            f"{_count(len(stops), 'corner')} of up to {math.degrees(stops.max()):.0f} degrees not rounded: it stops "
            f"there and turns, {float(limits.turning_s(stops).sum()):.1f} s in all"
        )
    if bend.any() and most[bend].min() < SAME * straight:
        radius = 1.0 / path.curvature[bend].max()
        said.append(
            f"bends of {radius:.2g} m radius: slowed down to {most[bend].min():.2f} m/s, which the thrusts allow"
        )
    steep = np.abs(np.nan_to_num(np.diff(path.depth))) / path.lengths * straight > descent_rate_mps / SAME
    if steep.any():
        said.append(
            f"depth changes faster than descent_rate_mps = {descent_rate_mps:g}: "
            f"slowed down to {most[steep].min():.2f} m/s"
        )
    schedule = along(path, speed_mps, limits, descent_rate_mps=descent_rate_mps)
    ideal = path.length_m / speed_mps
    if said or schedule.duration_s > 1.25 * ideal + 10.0:
        said.append(f"{path.length_m:.1f} m take {schedule.duration_s:.0f} s instead of {ideal:.0f} s")
    return said


def descent_notes(vehicle: Vehicle, rate_mps: float) -> list[str]:
    """A sentence where the vehicle cannot go down, or not at ``rate_mps``."""
    if vehicle.heave is None:
        return ["depth is wanted of a vehicle without a vertical thruster: it stays where it is"]
    heave, most = vehicle.heave, vehicle.thrusters[2].max_N
    push = (heave.linear_damping_kgps + heave.quadratic_damping_kgpm * rate_mps) * rate_mps + vehicle.net_buoyancy_N
    if push <= most / SAME:
        return []
    return [
        f"descent_rate_mps = {rate_mps:g} takes {push:.0f} N of the vertical thruster, which has {most:g} N: "
        "it goes down as fast as it can"
    ]


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
