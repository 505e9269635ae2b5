"""Where the target is when: a path and a speed along it, as one table that a cycle looks things up in.

The speed at each point of the path is at most the one that is wanted and the one that the vehicle can do there
(``limits.py``); from point to point it changes no faster than thrust and drag allow:

    v_(i+1)^2 <= v_i^2 + 2 ds min(F_ahead, F_full - D(v_i)) / M_x       forward, from the start
    v_i^2     <= v_(i+1)^2 + 2 ds (F_astern + D(v_(i+1))) / M_x         backward, from the end, where it stops

This is the time-optimal profile under these limits (Bobrow, Dubowsky & Gibson 1985, the two passes of its phase plane).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Times
from ltv_mpc.references.limits import Limits
from ltv_mpc.references.path import Path

STEP_M = 0.05
"""Between two rows of the table, where that gives no more than ``MOST_ROWS``."""
MOST_ROWS = 50_000

CREEP_MPS = 0.05
"""From this speed any vehicle stops within a step: drag alone would take for ever."""
ON_ARC = 0.9
"""Of the time of a turn: the heading leads the course, so that a part of the turn is done before the corner."""

TIME, WAY, NORTH, EAST, DEPTH = range(5)
"""Rows of the table: s since the start, m along the path, m north and east, m deep (NaN: not wanted)."""


class Schedule(NamedTuple):
    """The target's way. Between two columns of the table it moves evenly."""

    table: Array  # (5, M)
    lead_m: float  # of its way, what leads to the first point of the path

    @property
    def length_m(self) -> float:
        """Of the path."""
        return float(self.table[WAY, -1]) - self.lead_m

    @property
    def duration_s(self) -> float:
        """From the first point of the way to the last."""
        return float(self.table[TIME, -1])


def along(
    path: Path,
    speed_mps: float,
    limits: Limits,
    *,
    descent_rate_mps: float,
    start_mps: float = 0.0,
    lead_m: float = 0.0,
    first_turn_rad: float = 0.0,
) -> Schedule:
    """The fastest schedule within the limits, from ``start_mps`` to rest; it begins with a turn on the spot."""
    cap = np.minimum(speed_mps, fastest(path, limits, descent_rate_mps))
    ds = max(STEP_M, path.length_m / MOST_ROWS)
    way = np.concatenate([[0.0], np.cumsum(path.lengths)])
    parts = np.maximum(np.ceil(path.lengths / ds), 1).astype(np.int64)
    piece = np.repeat(np.arange(len(parts)), parts)  # of each step of the table
    last = np.cumsum(parts)
    fraction = 1.0 - (last[piece] - np.arange(len(piece)) - 1) / parts[piece]  # at its end
    s = np.concatenate([[0.0], way[piece] + fraction * path.lengths[piece]])
    of_step = cap[piece]
    at = np.minimum(np.concatenate([of_step, [0.0]]), np.concatenate([[start_mps], of_step]))
    waiting = np.zeros(len(s))
    corner = np.concatenate([[0], last])  # the rows of the path's own points
    waiting[corner] = limits.turning_s(path.stop)
    waiting[0] += float(limits.turning_s(np.array(first_turn_rad)))
    at[waiting > 0.0] = 0.0
    _, t = profile(
        s,
        at,
        limits.full_N,
        limits.ahead_N,
        limits.astern_N,
        limits.mass_kg,
        limits.linear_kgps,
        limits.quadratic_kgpm,
        waiting,
    )
    rows = np.repeat(np.arange(len(s)), 1 + (waiting > 0.0))  # where it waits it is at two times
    again = np.concatenate([[False], rows[1:] == rows[:-1]])
    table = np.empty((5, len(rows)))
    table[TIME] = t[rows] - np.where(again, 0.0, waiting[rows])
    table[WAY] = s[rows]
    for row, column in ((NORTH, path.points[:, 0]), (EAST, path.points[:, 1]), (DEPTH, path.depth)):
        table[row] = np.interp(table[WAY], way, column)
    return Schedule(table, lead_m)


def fastest(path: Path, limits: Limits, descent_rate_mps: float) -> Array:
    """(K-1,) m/s: the most that the vehicle can do on each piece: top speed, bends, corners, and going down."""
    speed = np.minimum(limits.cruise_mps, limits.speed_at(path.curvature))
    corner = path.turn > 0.0
    # A rounded corner is passed in no less than it takes to turn, but for what of the turn lies before and after it.
    arc = path.turn[corner] / path.curvature[corner]
    speed[corner] = np.minimum(speed[corner], arc / (ON_ARC * limits.turning_s(path.turn[corner])))
    slope = np.abs(np.nan_to_num(np.diff(path.depth))) / path.lengths
    steep = slope > 0.0
    speed[steep] = np.minimum(speed[steep], descent_rate_mps / slope[steep])
    return speed


@jit
def profile(
    s: Array,
    cap: Array,
    full: float,
    ahead: float,
    astern: float,
    mass: float,
    linear: float,
    quadratic: float,
    waiting: Array,
) -> tuple[Array, Array]:
    """Speeds (M,) m/s at s (M,) m, none above ``cap`` (M,), and the times (M,) s at which it goes on from there.

    It waits ``waiting`` (M,) s where that is not 0. Forces in N, drag (linear + quadratic v) v.
    """
    M = len(s)
    v, t = cap.copy(), np.empty(M)
    for i in range(M - 1):
        push = min(ahead, max(full - (linear + quadratic * v[i]) * v[i], 0.0))
        v[i + 1] = min(v[i + 1], np.sqrt(v[i] * v[i] + 2.0 * (s[i + 1] - s[i]) * push / mass))
    for i in range(M - 2, -1, -1):
        pull = astern + (linear + quadratic * v[i + 1]) * v[i + 1]
        before = np.sqrt(v[i + 1] * v[i + 1] + 2.0 * (s[i + 1] - s[i]) * pull / mass)
        v[i] = min(v[i], max(before, CREEP_MPS))
    t[0] = waiting[0]
    for i in range(M - 1):
        ds = s[i + 1] - s[i]
        # from rest to rest over ds it takes 2 sqrt(ds / a)
        speed = max(v[i] + v[i + 1], np.sqrt(ds * min(ahead, astern) / mass), CREEP_MPS)
        t[i + 1] = t[i] + 2.0 * ds / speed + waiting[i + 1]
    return v, t


@jit
def _interval(table: Array, tau: float) -> tuple[int, float, float]:
    """The interval of the table that a time lies in, the part of it that is past, and its length (s)."""
    M = table.shape[1]
    i = min(max(np.searchsorted(table[0], tau, side="right") - 1, 0), M - 2)
    length = table[0, i + 1] - table[0, i]
    part = (tau - table[0, i]) / length if length > 0.0 else 1.0
    return i, min(max(part, 0.0), 1.0), length


@jit
def where(table: Array, tau: float) -> tuple[float, float, float]:
    """Way along the path (m), north and east (m) at a time of the schedule."""
    i, part, _ = _interval(table, tau)
    s, n, e = table[1], table[2], table[3]
    return s[i] + part * (s[i + 1] - s[i]), n[i] + part * (n[i + 1] - n[i]), e[i] + part * (e[i + 1] - e[i])


@jit
def look_ahead(table: Array, tau: float, rate: float, t_ns: Times, target: Array) -> None:
    """The target at the knots, into ``target`` (N+1, 2): positions (m) at knots 1 .. N, then the velocity (m/s) at N.

    Knots t_ns (N+1,); at the first the schedule's time is ``tau``, and it goes on at ``rate`` seconds a second.
    """
    N = len(t_ns) - 1
    for k in range(1, N + 1):
        at = tau + rate * (t_ns[k] - t_ns[0]) * 1e-9
        i, part, length = _interval(table, at)
        for j in range(2):
            step = table[2 + j, i + 1] - table[2 + j, i]
            target[k - 1, j] = table[2 + j, i] + part * step
            if k == N:
                moving = length > 0.0 and 0.0 <= part < 1.0
                target[N, j] = rate * step / length if moving else 0.0


@jit
def against(table: Array, tau: float, ahead_s: float, north: float, east: float, speed: float) -> float:
    """The rate at which the schedule can be followed in a current (m/s) for ``ahead_s`` to come, 0 .. 1.

    The largest f <= 1 with |f v - c| <= ``speed``, the vehicle's through the water, at every velocity v wanted there;
    where the current alone is faster, 1: then nothing can be foretold.
    """
    square = north * north + east * east
    if square >= speed * speed or square == 0.0:
        return 1.0
    M, least = table.shape[1], 1.0
    i, _, _ = _interval(table, tau)
    while i < M - 1 and table[0, i] <= tau + ahead_s:
        length = table[0, i + 1] - table[0, i]
        if length > 0.0:
            vn, ve = (table[2, i + 1] - table[2, i]) / length, (table[3, i + 1] - table[3, i]) / length
            vv, vc = vn * vn + ve * ve, vn * north + ve * east
            # f^2 v.v - 2 f v.c + c.c = speed^2
            if vv > 0.0:
                least = min(least, (vc + np.sqrt(vc * vc + vv * (speed * speed - square))) / vv)
        i += 1
    return least


@jit
def depths(
    table: Array, tau: float, rate: float, t_ns: Times, begun_ns: int, start: float, most: float
) -> tuple[Array, Array]:
    """Depth (m) and sinking speed (m/s) at knots (N+1,): the path's, as far as ``most`` m/s from ``start`` allows."""
    depth, speed = np.empty(len(t_ns)), np.empty(len(t_ns))
    for k in range(len(t_ns)):
        at = tau + rate * (t_ns[k] - t_ns[0]) * 1e-9
        i, part, length = _interval(table, at)
        step = table[4, i + 1] - table[4, i]
        wanted = table[4, i] + part * step
        way = max((t_ns[k] - begun_ns) * 1e-9, 0.0) * most
        depth[k] = min(max(wanted, start - way), start + way)
        if depth[k] == wanted:
            speed[k] = rate * step / length if length > 0.0 and part < 1.0 else 0.0
        else:
            speed[k] = most if wanted > start else -most
    return depth, speed


@jit
def off_path(table: Array, s: float, n: float, e: float, window: float) -> float:
    """Cross-track error (m), positive to starboard: of a position from the nearest point within ``window`` m of s."""
    M = table.shape[1]
    way, north, east = table[1], table[2], table[3]
    first = max(int(np.searchsorted(way, s - window)) - 1, 0)
    least, signed = np.inf, 0.0
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
        if distance < least:
            least = distance
            signed = np.sqrt(distance) if dn * oe - de * on >= 0.0 else -np.sqrt(distance)
    return signed


@jit
def go_on(
    table: Array,
    tau: float,
    t_ns: Times,
    lateral: Array,
    north: float,
    east: float,
    leash: float,
    speed: float,
) -> tuple[float, float, float, float, float]:
    """At the first of a plan's knots, where the schedule is at ``tau``: its rate (s/s) from there on, the target's way
    along the path, north and east (m), and the vehicle's cross-track error (m; NaN where it is nowhere).

    The vehicle's state begins with ``lateral`` = n, e (m); ``north`` and ``east`` are the current (m/s); ``leash`` (m)
    as in ``follower.py``, ``speed`` (m/s) as in ``against``.
    """
    way, n, e = where(table, tau)
    distance = np.hypot(n - lateral[0], e - lateral[1])
    if not np.isfinite(distance):
        return 0.0, way, n, e, np.nan
    rate = min(max(2.0 - 2.0 * distance / leash, 0.0), 1.0)
    rate = min(rate, against(table, tau, float(t_ns[-1] - t_ns[0]) * 1e-9, north, east, speed))
    return rate, way, n, e, off_path(table, way, lateral[0], lateral[1], 2.0 * leash)
