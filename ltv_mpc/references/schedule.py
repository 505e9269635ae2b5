"""Schedule of a target along a path: time-optimal speed profile under the limits of the vehicle, as a lookup table.

The speed at each point of the path is at most the desired speed and the speed limit of the vehicle there
(``limits.py``). From point to point it changes no faster than thrust and drag allow:

    v_(i+1)^2 <= v_i^2 + 2 ds min(F_ahead, F_full - D(v_i)) / M_x       forward, from the start
    v_i^2     <= v_(i+1)^2 + 2 ds (F_astern + D(v_(i+1))) / M_x         backward, from the end, where it stops

This is the time-optimal profile under these limits (Bobrow, Dubowsky & Gibson 1985, two passes in the phase plane).

Arrays of the kernels below: ``table`` (5, M) as in ``Schedule``, ``t_ns`` (N+1,) knots of a plan (ns), ``tau`` the time
of the schedule (s) at the first knot, ``rate`` schedule seconds per vehicle second.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.jit import count_up_to, jit
from ltv_mpc.messages import Array, Times
from ltv_mpc.references.limits import Limits, SurgeLimits
from ltv_mpc.references.path import Path

STEP_M = 0.05
"""Spacing of the columns of the table along the path; larger if the table would exceed ``MAX_COLUMNS``."""
MAX_COLUMNS = 50_000

CREEP_MPS = 0.05
"""Speed from which any vehicle stops within one step; with drag alone it would never stop."""
TURN_SHARE_ON_ARC = 0.9
"""Share of the turning time spent on a bend; the heading leads the course, so the turn starts earlier."""
SAME_BEND = 5.0
STRAIGHT_M = 0.01
"""Distance of a bend from a straight line below which it is none: what the fit of legs leaves of the noise."""

TIME, WAY, NORTH, EAST, DEPTH = range(5)
"""Rows of the table: time since the start (s), distance along the path, north, east, depth (m; NaN: no depth)."""


class Schedule(NamedTuple):
    """Motion of the target, uniform between two columns of the table."""

    table: Array  # (5, M)
    lead_m: float  # length of the leg that leads to the first point of the path
    keeps_time: bool = False  # the user gave the times: they stay where a part of the track is left out

    @property
    def length_m(self) -> float:
        """Length of the path without the leg that leads to it."""
        return float(self.table[WAY, -1]) - self.lead_m

    @property
    def duration_s(self) -> float:
        """Time from the first column to the last."""
        return float(self.table[TIME, -1])


def fastest_schedule(
    path: Path,
    limits: Limits,
    *,
    descent_rate_mps: float,
    start_mps: float = 0.0,
    lead_m: float = 0.0,
    first_turn_rad: float = 0.0,
) -> Schedule:
    """Return the fastest schedule within the limits; it starts with a turn on the spot and ends at rest.

    Parameters
    ----------
    path : geometry of the path, including the leg that leads to it, with the wanted speeds over ground.
    limits : limits of the vehicle.
    descent_rate_mps : largest sinking speed (m/s).
    start_mps : speed along the path at its start (m/s).
    lead_m : length of the leg that leads to the path (m).
    first_turn_rad : angle of the turn on the spot at the start (rad), >= 0.
    """
    piece_limit = np.minimum(path.speed, speed_limits(path, limits, descent_rate_mps))
    ds = max(STEP_M, path.length_m / MAX_COLUMNS)
    way = np.concatenate([[0.0], np.cumsum(path.lengths)])
    parts = np.maximum(np.ceil(path.lengths / ds), 1).astype(np.int64)
    piece = np.repeat(np.arange(len(parts)), parts)  # index for each step of the table
    last = np.cumsum(parts)
    fraction = 1.0 - (last[piece] - np.arange(len(piece)) - 1) / parts[piece]  # at the end of the step
    s = np.concatenate([[0.0], way[piece] + fraction * path.lengths[piece]])
    step_limit = piece_limit[piece]
    limit = np.minimum(np.concatenate([step_limit, [0.0]]), np.concatenate([[start_mps], step_limit]))
    waiting = np.zeros(len(s))
    corner = np.concatenate([[0], last])  # columns of the points of the path
    waiting[corner] = limits.turning_s(path.turn_on_spot) + path.wait
    waiting[0] += float(limits.turning_s(np.array(first_turn_rad)))
    # A step in depth alone takes its time at rest.
    down = (path.lengths == 0.0)[piece]
    sinking_s = np.where(down, np.abs(np.nan_to_num(np.diff(path.depth)))[piece] / descent_rate_mps, 0.0)
    limit[waiting > 0.0] = limit[1:][down] = limit[:-1][down] = 0.0
    t = departure_times(s, limit, step_limit, waiting, limits.surge)
    t[1:] += np.cumsum(sinking_s)
    columns = np.repeat(np.arange(len(s)), 1 + (waiting > 0.0))  # two columns for a point at which the target waits
    leaves = np.concatenate([[False], columns[1:] == columns[:-1]])
    table = np.empty((5, len(columns)))
    table[TIME] = t[columns] - np.where(leaves, 0.0, waiting[columns])
    table[WAY] = s[columns]
    at = np.concatenate([[0.0], piece + fraction])[columns]
    for row, column in ((NORTH, path.points[:, 0]), (EAST, path.points[:, 1]), (DEPTH, path.depth)):
        table[row] = np.interp(at, np.arange(len(way)), column)
    return Schedule(table, lead_m)


def speed_limits(path: Path, limits: Limits, descent_rate_mps: float) -> Array:
    """Return the largest speed (K-1,) in m/s on each piece: by cruising speed, bends, corners and descent.

    Parameters
    ----------
    path : geometry with K points.
    limits : limits of the vehicle.
    descent_rate_mps : largest sinking speed (m/s).
    """
    curvature, turn, length_m = bends(path, limits.turn_in_m)
    speed = np.minimum(limits.cruise_mps, limits.speed_at(curvature))
    # A bend takes at least the turning time, except for the part of the turn before and after it.
    bent = turn > 0.0
    turning_s = TURN_SHARE_ON_ARC * limits.turning_s(turn[bent])
    speed[bent] = np.minimum(speed[bent], length_m[bent] / turning_s)
    speed = np.maximum(speed, 0.5 * CREEP_MPS)  # a vehicle without thrust astern has no steady speed in a sharp bend
    rise_m = np.abs(np.nan_to_num(np.diff(path.depth)))
    steep = (rise_m > 0.0) & (path.lengths > 0.0)
    speed[steep] = np.minimum(speed[steep], descent_rate_mps * path.lengths[steep] / rise_m[steep])
    return speed


def bends(path: Path, turn_in_m: float) -> tuple[Array, Array, Array]:
    """Return curvature (1/m), turn (rad, 0 on a smooth curve) and length (m) of the bend of each piece, each (K-1,).

    Rounded corners in the same direction are one bend if they are nearer than ``turn_in_m`` and their radii differ by
    less than the factor ``SAME_BEND``: the turn of a curve does not depend on the number of its points. The curvature
    is the mean over ``turn_in_m`` within the bend. A bend that leaves its tangent by less than ``STRAIGHT_M`` over that
    length is straight.

    Parameters
    ----------
    path : geometry with K points.
    turn_in_m : length in which the vehicle turns in (m).
    """
    way = np.concatenate([[0.0], np.cumsum(path.lengths)])
    heading = np.concatenate([[0.0], np.cumsum(path.curvature * path.lengths)])
    arc = np.flatnonzero(path.turn)
    ratio = path.curvature[arc[1:]] / path.curvature[arc[:-1]]
    same = (path.turn[arc[1:]] * path.turn[arc[:-1]] > 0.0) & (way[arc[1:]] - way[arc[:-1] + 1] < turn_in_m)
    apart = np.flatnonzero(~same | (ratio > SAME_BEND) | (ratio < 1.0 / SAME_BEND))
    begin, end = arc[np.append(0, apart + 1)[: len(arc)]], arc[np.append(apart, -1)[: len(arc)]] + 1
    of = np.repeat(np.arange(len(begin)), end - begin)  # bend of each of its pieces
    piece = np.concatenate([[], *map(np.arange, begin, end)]).astype(np.int64)
    curvature, turn, length_m = path.curvature.copy(), np.zeros(len(path.turn)), np.zeros(len(path.turn))
    turn[piece], length_m[piece] = (heading[end] - heading[begin])[of], (way[end] - way[begin])[of]
    middle = 0.5 * (way[piece] + way[piece + 1])
    low = np.maximum(middle - 0.5 * turn_in_m, way[begin][of])
    high = np.minimum(middle + 0.5 * turn_in_m, way[end][of])
    curvature[piece] = np.diff(np.interp([low, high], way, heading), axis=0)[0] / (high - low)
    straight = (path.turn != 0.0) & (turn * np.maximum(length_m, turn_in_m) < 8.0 * STRAIGHT_M)
    curvature[straight] = turn[straight] = 0.0
    return curvature, turn, length_m


@jit
def departure_times(s: Array, limit: Array, step_limit: Array, waiting: Array, surge: SurgeLimits) -> Array:
    """Return the times (M,) in s at which the target leaves each point.

    Parameters
    ----------
    s : (M,) distance along the path (m).
    limit : (M,) speed limit at each point (m/s).
    step_limit : (M-1,) speed limit between them (m/s).
    waiting : (M,) time at rest at each point (s).
    surge : forces, mass and drag along the path.
    """
    M = len(s)
    v, t = limit.copy(), np.empty(M)
    mass, linear, quadratic, astern = surge.mass_kg, surge.linear_kgps, surge.quadratic_kgpm, surge.astern_N
    for i in range(M - 1):
        push = min(surge.ahead_N, max(surge.full_N - (linear + quadratic * v[i]) * v[i], 0.0))
        v[i + 1] = min(v[i + 1], np.sqrt(v[i] * v[i] + 2.0 * (s[i + 1] - s[i]) * push / mass))
    for i in range(M - 2, -1, -1):
        pull = astern + (linear + quadratic * v[i + 1]) * v[i + 1]
        before = np.sqrt(v[i + 1] * v[i + 1] + 2.0 * (s[i + 1] - s[i]) * pull / mass)
        v[i] = min(v[i], max(before, CREEP_MPS))
    t[0] = waiting[0]
    for i in range(M - 1):
        ds = s[i + 1] - s[i]
        # a step from rest to rest takes 2 sqrt(ds / a), or more at its speed limit
        speed = max(0.5 * (v[i] + v[i + 1]), 0.5 * np.sqrt(ds * min(surge.ahead_N, astern) / mass), 0.5 * CREEP_MPS)
        t[i + 1] = t[i] + ds / min(speed, step_limit[i]) + waiting[i + 1]
    return t


@jit
def target_at(table: Array, tau: float) -> tuple[float, float, float]:
    """Return distance along the path, north and east of the target (m).

    Parameters
    ----------
    table : (5, M) table of the schedule.
    tau : time of the schedule (s).
    """
    t, s, n, e = table[0], table[1], table[2], table[3]
    i = min(max(count_up_to(t, tau) - 1, 0), len(t) - 2)
    length = t[i + 1] - t[i]
    part = min(max((tau - t[i]) / length, 0.0), 1.0) if length > 0.0 else 1.0
    return s[i] + part * (s[i + 1] - s[i]), n[i] + part * (n[i + 1] - n[i]), e[i] + part * (e[i + 1] - e[i])


@jit
def fill_targets(table: Array, tau: float, rate: float, t_ns: Times, target: Array) -> None:
    """Write the target at the knots of a plan.

    Parameters
    ----------
    table : (5, M) table of the schedule.
    tau : time of the schedule at the first knot (s).
    rate : schedule seconds per vehicle second.
    t_ns : (N+1,) knots (ns).
    target : (N+1, 2) output, north and east: positions (m) at knots 1 .. N, then the velocity (m/s) at knot N.
    """
    N = len(t_ns) - 1
    for k in range(1, N + 1):
        at = tau + rate * (t_ns[k] - t_ns[0]) * 1e-9
        _, target[k - 1, 0], target[k - 1, 1] = target_at(table, at)
    target[N] = 0.0
    i = count_up_to(table[0], at)
    if 0 < i < table.shape[1]:
        for j in range(2):
            target[N, j] = rate * (table[2 + j, i] - table[2 + j, i - 1]) / (table[0, i] - table[0, i - 1])


@jit
def feasible_rate(table: Array, tau: float, ahead_s: float, north: float, east: float, speed: float) -> float:
    """Return the rate, 0 .. 1, at which the vehicle can follow the schedule in a current.

    Each velocity v of the target in the interval allows the largest f with |f v - c| <= ``speed``. If no f does, it
    allows the f that comes nearest, which is 0 against and across a current that is faster than the vehicle. A velocity
    that the target has only later does not count at rates at which the interval ends before.

    Parameters
    ----------
    table : (5, M) table of the schedule.
    tau : start of the interval in schedule time (s).
    ahead_s : length of the interval at rate 1 (s).
    north, east : current c (m/s).
    speed : largest speed of the vehicle through the water (m/s).
    """
    square = north * north + east * east
    M, rate = table.shape[1], 1.0
    i = min(max(count_up_to(table[0], tau) - 1, 0), M - 2)
    while i < M - 1 and table[0, i] <= tau + ahead_s:
        length = table[0, i + 1] - table[0, i]
        if length > 0.0:
            vn, ve = (table[2, i + 1] - table[2, i]) / length, (table[3, i + 1] - table[3, i]) / length
            vv, vc = vn * vn + ve * ve, vn * north + ve * east
            # f^2 v.v - 2 f v.c + c.c = speed^2
            if vv > 0.0:
                allowed = (vc + np.sqrt(max(vc * vc + vv * (speed * speed - square), 0.0))) / vv
                rate = min(rate, max(allowed, (table[0, i] - tau) / ahead_s, 0.0))
        i += 1
    return rate


@jit
def cross_track_error(table: Array, s: float, n: float, e: float, window: float) -> float:
    """Return the cross-track error (m), positive to starboard: the distance of a position from the path.

    Parameters
    ----------
    table : (5, M) table of the schedule.
    s : distance of the target along the path (m).
    n, e : position (m).
    window : only the path within this distance of ``s`` counts (m).
    """
    M = table.shape[1]
    way, north, east = table[1], table[2], table[3]
    first = max(count_up_to(way, s - window) - 1, 0)
    nearest, signed = np.inf, 0.0
    for i in range(first, M - 1):
        if way[i] > s + window:
            break
        dn, de = north[i + 1] - north[i], east[i + 1] - east[i]
        square = dn * dn + de * de
        if square == 0.0:
            continue
        part = min(max(((n - north[i]) * dn + (e - east[i]) * de) / square, 0.0), 1.0)
        on, oe = n - north[i] - part * dn, e - east[i] - part * de
        distance = on * on + oe * oe
        if distance < nearest:
            nearest = distance
            signed = np.sqrt(distance) if dn * oe - de * on >= 0.0 else -np.sqrt(distance)
    return signed


@jit
def advance_target(
    table: Array,
    tau: float,
    t_ns: Times,
    lateral: Array,
    current: tuple[float, float],
    leash: float,
    speed: float,
    target: Array,
) -> tuple[float, float, float]:
    """Write the target at the knots of a plan, and return its state at the first one.

    Parameters
    ----------
    table : (5, M) table of the schedule.
    tau : time of the schedule at the first knot (s).
    t_ns : (N+1,) knots (ns).
    lateral : state of the vehicle at the first knot, which starts with n, e (m).
    current : velocity of the water, north and east (m/s).
    leash : distance between target and vehicle at which the target stops (m), as in ``follower.py``.
    speed : largest speed of the vehicle through the water (m/s).
    target : (N+1, 2) output, as in ``fill_targets``.

    Returns
    -------
    rate : rate of the schedule from here on (s/s).
    way : distance of the target along the path (m).
    cross : cross-track error of the vehicle (m), positive to starboard; NaN if its position is not finite.
    """
    way, n, e = target_at(table, tau)
    distance = np.hypot(n - lateral[0], e - lateral[1])
    rate, cross = 0.0, np.nan
    if np.isfinite(distance):
        rate = min(max(2.0 - 2.0 * distance / leash, 0.0), 1.0)
        rate *= feasible_rate(table, tau, float(t_ns[-1] - t_ns[0]) * 1e-9, current[0], current[1], speed)
        cross = cross_track_error(table, way, lateral[0], lateral[1], 2.0 * leash)
    fill_targets(table, tau, rate, t_ns, target)
    return rate, way, cross
