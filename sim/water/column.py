"""Water column: horizontal water velocity over depth and time.

c(z, t) = [north, east] (m/s), linear in z between cells, constant above the first and below the last cell.
Slow change: each cell and axis follows a random walk in time, c_k(t) = c_k(0) + q W_k(t), with q in m/s per sqrt(s) and
W_k a Wiener process, sampled every second and linear in between. W is a pure function of seed and whole second, so all
processes that build this column from one seed have the same water. W(0) = 0, and before t = 0 the walk runs backwards.
A feature (``features.py``) is added on top. It may bring depths of its own and is likewise sampled every second.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, CurrentProfile, Pair
from sim.random_streams import Stream, generator

KNOT_NS = 1_000_000_000
"""Time between two samples of the walk."""

_MAX_CACHED = 256
"""Number of samples of the walk that are cached; an older one is generated again from the start, to the same bits."""


class WaterSample(NamedTuple):
    """Water column at one instant, for compiled code: linear in time between two samples."""

    depth_m: Array  # (K,) strictly increasing
    earlier: Array  # (K, 2) velocity north and east (m/s) at the whole second before
    later: Array  # (K, 2) the same one second later
    weight: float  # of the later sample, 0 to 1


class WaterWindow(NamedTuple):
    """Water column at several instants between the same two samples, for compiled code."""

    depth_m: Array  # (K,) strictly increasing
    earlier: Array  # (K, 2) velocity north and east (m/s) at the whole second before
    later: Array  # (K, 2) the same one second later
    weights: Array  # (M,) of the later sample, 0 to 1


class _Walk:
    """Samples of q W at whole seconds on one side of t = 0, each of shape (K, 2)."""

    def __init__(self, seed: int, stream: Stream, cells: int, change: float) -> None:
        self._seed, self._stream, self._shape, self._change = seed, stream, (cells, 2), change
        self._restart()

    def _restart(self) -> None:
        self._draws = generator(self._seed, self._stream)
        self._last, self._value = 0, np.zeros(self._shape)
        self._cache: OrderedDict[int, Array] = OrderedDict({0: self._value})

    def at(self, second: int) -> Array:
        if second <= self._last and second not in self._cache:
            self._restart()
        while self._last < second:
            self._value = self._value + self._change * self._draws.standard_normal(self._shape)
            self._last += 1
            self._cache[self._last] = self._value
            if len(self._cache) > _MAX_CACHED:
                self._cache.popitem(last=False)
        return self._cache[second]


class Overlay(Protocol):
    """Velocity that is added to a water column."""

    steady: bool  # constant in time

    def depths(self, own_m: Array) -> Array:
        """Return the depths (m) between which column and overlay together are linear, strictly increasing, (K,)."""
        ...

    def velocity(self, depth_m: Array, t_s: float) -> Array:
        """Return the added velocity north and east (m/s) at each depth, shape (K, 2)."""
        ...


class WaterColumn:
    """True current of a run over depth and time."""

    def __init__(
        self,
        depth_m: Array,
        velocity_mps: Array,
        *,
        change_mps_per_rts: float = 0.0,
        seed: int = 0,
        feature: Overlay | None = None,
    ) -> None:
        """Build the column from its profile at t = 0.

        Parameters
        ----------
        depth_m : (K,) depths of the cells, strictly increasing.
        velocity_mps : (K, 2) velocity north and east at t = 0.
        change_mps_per_rts : q of the random walk (m/s per sqrt(s)); with 0 the column draws no random number.
        seed : seed of the run.
        feature : overlay. Without a walk, and without a feature that changes in time, the column is constant in time.
        """
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
        first = self._at_second(0)
        self._ends = (first, first) if self._still else (first, self._at_second(1))

    @property
    def depth_m(self) -> Array:
        """Depths (m) between which the current is linear: the cells' centres and those of the feature, shape (K,)."""
        return self._depth

    def _at_second(self, second: int) -> Array:
        c = self._own
        if self._walks:
            c = c + (self._after.at(second) if second >= 0 else self._before.at(-second))
        if self._feature is None:
            return c
        north, east = (np.interp(self._depth, self._own_depth, axis) for axis in c.T)
        return np.column_stack([north, east]) + self._feature.velocity(self._depth, float(second))

    def sample(self, t_ns: int) -> WaterSample:
        """Return the column at ``t_ns``, for compiled code."""
        if self._still:
            return WaterSample(self._depth, self._ends[0], self._ends[0], 0.0)
        second = t_ns // KNOT_NS
        if second != self._second:
            self._second, self._ends = second, (self._at_second(second), self._at_second(second + 1))
        return WaterSample(self._depth, self._ends[0], self._ends[1], (t_ns - second * KNOT_NS) / KNOT_NS)

    def window(self, times_ns: Sequence[int]) -> WaterWindow:
        """Return the column at times of one whole second, of which its end is no part, for compiled code."""
        depth, earlier, later, _ = self.sample(times_ns[0])
        if self._still:
            return WaterWindow(depth, earlier, later, np.zeros(len(times_ns)))
        return WaterWindow(depth, earlier, later, np.array([self.sample(t_ns).weight for t_ns in times_ns]))

    def at(self, depth_m: float, t_ns: int) -> Pair:
        """Return the velocity north and east (m/s) at one depth."""
        return velocity_at(depth_m, self.sample(t_ns))

    def gradient(self, depth_m: float, t_ns: int) -> Pair:
        """Return dc/dz (1/s), north and east: 0 beyond both ends, at a cell's centre the value of the side below."""
        return gradient_at(depth_m, self.sample(t_ns))

    def over(self, depths_m: Array, t_ns: int) -> Array:
        """Return the velocities (m/s) at many depths (J,), shape (J, 2)."""
        return velocities_over(np.ascontiguousarray(depths_m, dtype=np.float64), self.sample(t_ns))

    def profile(self, t_ns: int) -> CurrentProfile:
        """Return the column at ``t_ns`` as a current profile."""
        _, earlier, later, weight = self.sample(t_ns)
        now = earlier + weight * (later - earlier)
        return CurrentProfile(depth_m=self._depth.copy(), north_mps=now[:, 0].copy(), east_mps=now[:, 1].copy())


@jit
def _cell(depth: float, depths: Array) -> int:
    """Return the last k with depths[k] <= depth, or -1 above the first."""
    low, high = -1, len(depths)
    while high - low > 1:
        middle = (low + high) // 2
        if depths[middle] <= depth:
            low = middle
        else:
            high = middle
    return low


@jit
def velocity_at(depth: float, water: WaterSample) -> Pair:
    """Return the velocity c = (1 - w) c_k + w c_k+1 (m/s) at a depth, interpolated likewise in time."""
    depths, earlier, later, weight = water.depth_m, water.earlier, water.later, water.weight
    k = _cell(depth, depths)
    last = len(depths) - 1
    a, b = max(k, 0), min(k + 1, last)
    w = 0.0 if k < 0 or k >= last else (depth - depths[k]) / (depths[k + 1] - depths[k])
    north = earlier[a, 0] + w * (earlier[b, 0] - earlier[a, 0])
    east = earlier[a, 1] + w * (earlier[b, 1] - earlier[a, 1])
    # No branch for a weight of 0: it would cost more, because numba then counts references to ``later`` on both paths.
    north += weight * (later[a, 0] + w * (later[b, 0] - later[a, 0]) - north)
    east += weight * (later[a, 1] + w * (later[b, 1] - later[a, 1]) - east)
    return north, east


@jit
def gradient_at(depth: float, water: WaterSample) -> Pair:
    """Return the gradient dc/dz = (c_k+1 - c_k) / (z_k+1 - z_k) (1/s) at a depth, 0 beyond the cells."""
    depths, earlier, later, weight = water.depth_m, water.earlier, water.later, water.weight
    k = _cell(depth, depths)
    last = len(depths) - 1
    a, b = max(k, 0), min(k + 1, last)
    step = depths[b] - depths[a]
    north = earlier[b, 0] - earlier[a, 0]
    east = earlier[b, 1] - earlier[a, 1]
    north += weight * (later[b, 0] - later[a, 0] - north)
    east += weight * (later[b, 1] - later[a, 1] - east)
    within = step > 0.0  # else beyond
    return (north / step if within else 0.0), (east / step if within else 0.0)


@jit
def velocities_over(at: Array, water: WaterSample) -> Array:
    """Return ``velocity_at`` of each depth in ``at`` (J,), shape (J, 2)."""
    c = np.empty((len(at), 2))
    for j in range(len(at)):
        c[j, 0], c[j, 1] = velocity_at(at[j], water)
    return c
