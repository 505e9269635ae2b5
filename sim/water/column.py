"""Horizontal water velocity over depth and time.

c(z, t) = [north, east] (m/s), linear in z between cells, constant above the first and below the last.
Slow change: each cell and axis walks at random in time, c_k(t) = c_k(0) + q W_k(t), with q in m/s per sqrt(s) and W_k
a Wiener process, sampled every second and linear between. W is a pure function of seed and whole second, so every
process that makes this column from the same seed has the same water; W(0) = 0, before it the walk runs backwards.
A feature is added to that, with depths of its own between the cells, and likewise sampled every second.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, CurrentProfile, Pair
from sim.random_streams import Stream, generator

KNOT_NS = 1_000_000_000
"""Time between two samples of the walk."""

_KEPT = 256
"""Samples of the walk that are remembered; an older one is generated again from the start, to the same bits."""


class _Walk:
    """Samples of q W at whole seconds on one side of t = 0, shape (K, 2) each."""

    def __init__(self, seed: int, stream: Stream, cells: int, change: float) -> None:
        self._seed, self._stream, self._shape, self._change = seed, stream, (cells, 2), change
        self._restart()

    def _restart(self) -> None:
        self._draws = generator(self._seed, self._stream)
        self._last, self._value = 0, np.zeros(self._shape)
        self._kept: OrderedDict[int, Array] = OrderedDict({0: self._value})

    def at(self, second: int) -> Array:
        if second <= self._last and second not in self._kept:
            self._restart()
        while self._last < second:
            self._value = self._value + self._change * self._draws.standard_normal(self._shape)
            self._last += 1
            self._kept[self._last] = self._value
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        return self._kept[second]


class Overlay(Protocol):
    """What a column adds to itself."""

    steady: bool  # the same at all times

    def depths(self, own_m: Array) -> Array:
        """All depths that column and overlay together bend at, strictly increasing, shape (K,)."""
        ...

    def velocity(self, depth_m: Array, t_s: float) -> Array:
        """North and east velocity (m/s) on top at each depth, shape (K, 2)."""
        ...


class WaterColumn:
    """The true current. ``depth_m`` (K,) strictly increasing, ``velocity_mps`` (K, 2) north and east at t = 0."""

    def __init__(
        self,
        depth_m: Array,
        velocity_mps: Array,
        *,
        change_mps_per_rts: float = 0.0,
        seed: int = 0,
        feature: Overlay | None = None,
    ) -> None:
        """Without ``change_mps_per_rts`` the column draws nothing; without a feature that changes it stands still."""
        self._own_depth = np.ascontiguousarray(depth_m, dtype=np.float64)
        self._own = np.ascontiguousarray(velocity_mps, dtype=np.float64)
        if self._own.shape != (len(self._own_depth), 2) or len(self._own_depth) == 0:
            raise ValueError(f"depths {self._own_depth.shape} and velocities {self._own.shape} do not match")
        self._feature = feature
        self._depth = self._own_depth if feature is None else feature.depths(self._own_depth)
        self._walks = change_mps_per_rts != 0.0
        self._still = not self._walks and (feature is None or feature.steady)
        cells = len(self._own_depth)
        self._after = _Walk(seed, Stream.WATER_CHANGE_AFTER, cells, change_mps_per_rts)
        self._before = _Walk(seed, Stream.WATER_CHANGE_BEFORE, cells, change_mps_per_rts)
        self._second = 0
        first = self._sample(0)
        self._ends = (first, first) if self._still else (first, self._sample(1))

    @property
    def depth_m(self) -> Array:
        """Depths between which the current is linear: each cell's centre, and a feature's, shape (K,)."""
        return self._depth

    def _sample(self, second: int) -> Array:
        c = self._own
        if self._walks:
            c = c + (self._after.at(second) if second >= 0 else self._before.at(-second))
        if self._feature is None:
            return c
        north, east = (np.interp(self._depth, self._own_depth, axis) for axis in c.T)
        return np.column_stack([north, east]) + self._feature.velocity(self._depth, float(second))

    def between(self, t_ns: int) -> tuple[Array, Array, float]:
        """Velocities (K, 2) at the whole seconds around ``t_ns``, and the share of the later one, for kernels."""
        if self._still:
            return self._ends[0], self._ends[0], 0.0
        second = t_ns // KNOT_NS
        if second != self._second:
            self._second, self._ends = second, (self._sample(second), self._sample(second + 1))
        return self._ends[0], self._ends[1], (t_ns - second * KNOT_NS) / KNOT_NS

    def throughout(self, times_ns: Sequence[int]) -> tuple[Array, Array, Array]:
        """``between`` at times of one second, its end left out: both samples, and each time's share, (M,)."""
        earlier, later, _ = self.between(times_ns[0])
        if self._still:
            return earlier, later, np.zeros(len(times_ns))
        return earlier, later, np.array([self.between(t_ns)[2] for t_ns in times_ns])

    def at(self, depth_m: float, t_ns: int) -> Pair:
        """North and east velocity (m/s)."""
        earlier, later, share = self.between(t_ns)
        return velocity_at(depth_m, self._depth, earlier, later, share)

    def gradient(self, depth_m: float, t_ns: int) -> Pair:
        """dc/dz (1/s), north and east; zero beyond both ends, at a cell's centre that of the side below."""
        earlier, later, share = self.between(t_ns)
        return gradient_at(depth_m, self._depth, earlier, later, share)

    def over(self, depths_m: Array, t_ns: int) -> Array:
        """Velocities at many depths, shape (K, 2)."""
        earlier, later, share = self.between(t_ns)
        return velocities_over(np.ascontiguousarray(depths_m, dtype=np.float64), self._depth, earlier, later, share)

    def profile(self, t_ns: int) -> CurrentProfile:
        """The whole column at ``t_ns``."""
        earlier, later, share = self.between(t_ns)
        now = earlier + share * (later - earlier)
        return CurrentProfile(depth_m=self._depth.copy(), north_mps=now[:, 0].copy(), east_mps=now[:, 1].copy())


@jit
def _cell(depth: float, depths: Array) -> int:
    """The last k with depths[k] <= depth, -1 above the first."""
    low, high = -1, len(depths)
    while high - low > 1:
        middle = (low + high) // 2
        if depths[middle] <= depth:
            low = middle
        else:
            high = middle
    return low


@jit
def velocity_at(depth: float, depths: Array, earlier: Array, later: Array, share: float) -> Pair:
    """Water velocity c = (1 - w) c_k + w c_k+1 in depth, and the same in time with ``share``."""
    k = _cell(depth, depths)
    last = len(depths) - 1
    a, b = max(k, 0), min(k + 1, last)
    w = 0.0 if k < 0 or k >= last else (depth - depths[k]) / (depths[k + 1] - depths[k])
    north = earlier[a, 0] + w * (earlier[b, 0] - earlier[a, 0])
    east = earlier[a, 1] + w * (earlier[b, 1] - earlier[a, 1])
    # Also where the share is zero: to branch costs more, for then who holds ``later`` is counted on both ways.
    north += share * (later[a, 0] + w * (later[b, 0] - later[a, 0]) - north)
    east += share * (later[a, 1] + w * (later[b, 1] - later[a, 1]) - east)
    return north, east


@jit
def gradient_at(depth: float, depths: Array, earlier: Array, later: Array, share: float) -> Pair:
    """Gradient dc/dz = (c_k+1 - c_k) / (z_k+1 - z_k) within the cells, 0 beyond."""
    k = _cell(depth, depths)
    last = len(depths) - 1
    a, b = max(k, 0), min(k + 1, last)
    step = depths[b] - depths[a]
    north = earlier[b, 0] - earlier[a, 0]
    east = earlier[b, 1] - earlier[a, 1]
    north += share * (later[b, 0] - later[a, 0] - north)
    east += share * (later[b, 1] - later[a, 1] - east)
    within = step > 0.0  # else beyond
    return (north / step if within else 0.0), (east / step if within else 0.0)


@jit
def velocities_over(at: Array, depths: Array, earlier: Array, later: Array, share: float) -> Array:
    """``velocity_at`` for each depth of ``at`` (J,), shape (J, 2)."""
    c = np.empty((len(at), 2))
    for j in range(len(at)):
        c[j, 0], c[j, 1] = velocity_at(at[j], depths, earlier, later, share)
    return c
