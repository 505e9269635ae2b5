"""Feasibility notes: sentences about the parts of a reference that a vehicle cannot follow."""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.references.limits import SUSTAINED_SHARE, Limits
from ltv_mpc.references.path import Path
from ltv_mpc.references.schedule import bends, fastest_schedule, speed_limits
from ltv_mpc.vehicle.parameters import Vehicle

EQUAL = 0.99
"""Share of the desired speed from which a speed counts as equal to it."""


def path_notes(path: Path, limits: Limits, descent_rate_mps: float) -> list[str]:
    """Return sentences about the parts of a path that the vehicle cannot follow at the desired speed.

    Parameters
    ----------
    path : geometry of the path, with the wanted speeds over ground.
    limits : limits of the vehicle.
    descent_rate_mps : largest sinking speed (m/s).
    """
    notes = []
    speed_mps = float(path.speed.max())
    straight = np.minimum(path.speed, limits.cruise_mps)
    if limits.cruise_mps < EQUAL * speed_mps:
        notes.append(
            f"speed_mps = {speed_mps:g} is reduced to {limits.cruise_mps:.2f} m/s, which {SUSTAINED_SHARE:.0%} of the "
            f"thrust holds in still water; full thrust holds {limits.top_mps:.2f} m/s"
        )
    limit = speed_limits(path, limits, descent_rate_mps)
    curvature, turn, _ = bends(path, limits.turn_in_m)
    corner = (turn > 0.0) & (np.abs(path.turn) > EQUAL * turn)
    bend = ~corner & (curvature > 0.0)
    slower = limit < EQUAL * straight
    if (slower & corner).any():
        corners = int(np.count_nonzero(np.diff(corner.astype(np.int64), prepend=0) > 0))  # each is a run of pieces
        sharpest = turn[corner].max()
        notes.append(
            f"{_count(corners, 'corner')} of up to {math.degrees(sharpest):.0f} degrees: speed reduced to "
            f"{limit[corner].min():.2f} m/s, because the vehicle turns at {limits.yaw_radps:.2f} rad/s at most and "
            f"needs {float(limits.turning_s(sharpest)):.1f} s for the turn"
        )
    stops = path.turn_on_spot[path.turn_on_spot > 0.0]
    if len(stops):
        notes.append(
            f"{_count(len(stops), 'corner')} of up to {math.degrees(stops.max()):.0f} degrees not rounded: the vehicle "
            f"stops there and turns, {float(limits.turning_s(stops).sum()):.1f} s in total"
        )
    if (slower & bend).any():
        radius = 1.0 / curvature[bend].max()
        notes.append(
            f"bends of {radius:.2g} m radius: speed reduced to {limit[bend].min():.2f} m/s, which the thrusts allow"
        )
    rise_m = np.abs(np.nan_to_num(np.diff(path.depth)))
    steep = (path.lengths > 0.0) & (rise_m * straight > descent_rate_mps / EQUAL * path.lengths)
    if steep.any():
        notes.append(
            f"depth changes faster than descent_rate_mps = {descent_rate_mps:g}: "
            f"speed reduced to {limit[steep].min():.2f} m/s"
        )
    schedule = fastest_schedule(path, limits, descent_rate_mps=descent_rate_mps)
    still_s = rise_m[path.lengths == 0.0].sum() / descent_rate_mps + path.wait.sum()
    ideal = float((path.lengths / path.speed).sum() + still_s)
    if notes or schedule.duration_s > 1.25 * ideal + 10.0:
        notes.append(f"{path.length_m:.1f} m take {schedule.duration_s:.0f} s instead of {ideal:.0f} s")
    return notes


def descent_notes(vehicle: Vehicle, rate_mps: float) -> list[str]:
    """Return a sentence if the vehicle cannot descend, or not at the given rate.

    Parameters
    ----------
    vehicle : parameters of the vehicle.
    rate_mps : sinking speed (m/s).
    """
    if vehicle.heave is None:
        return ["the reference has a depth, but the vehicle has no vertical thruster: its depth does not change"]
    heave, max_N = vehicle.heave, vehicle.thrusters[2].max_N
    push = (heave.linear_damping_kgps + heave.quadratic_damping_kgpm * rate_mps) * rate_mps + vehicle.net_buoyancy_N
    if push <= max_N / EQUAL:
        return []
    return [
        f"descent_rate_mps = {rate_mps:g} takes {push:.0f} N of the vertical thruster, which has {max_N:g} N: "
        "the vehicle descends as fast as it can"
    ]


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
