"""Water column: horizontal water velocity over depth and time.

c(z, t) = [north, east] (m/s). Over depth it is linear between the cells, and constant above the first and below the
last cell. In time it is sampled every second, and linear in between.

Slow change  Each cell and axis follows a random walk, c_k(t) = c_k(0) + q W_k(t), with q in m/s per sqrt(s) and W_k a
             Wiener process with W_k(0) = 0. A second, independent walk gives the times before t = 0.
Seed         W is a pure function of seed and whole second. All processes that build the column from one seed have the
             same water.
Feature      A feature of the water (``features.py``) is added, also sampled every second. It may add depths to those of
             the cells.
Waves        The orbital velocity of surface waves (``surface_waves.py``) is added at each time. A profile does not
             contain it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np

from ltv_mpc.bounded import remember
from ltv_mpc.jit import count_up_to, jit
from ltv_mpc.messages import Array, CurrentProfile, Pair, Triple
from sim.random_streams import Stream, generator
from sim.water.surface_waves import SurfaceWaves

SAMPLE_PERIOD_NS = 1_000_000_000
"""Time between two samples of the column."""

_MAX_CACHED = 256
"""Number of samples of a walk that are cached. An older sample is generated again: the walk is repeated from t = 0,
with bitwise the same result.
"""


class WaterSample(NamedTuple):
    """Water column at one instant, for compiled code: two samples, between which it is linear in time."""

    depth_m: Array  # (K,) strictly increasing
    earlier: Array  # (K, 2) velocity north and east (m/s) at the whole second before
    later: Array  # (K, 2) the same one second later
    time_weight: float  # of the later sample, 0 to 1
    wave: Triple = (0.0, 0.0, 0.0)  # velocity north and east at the surface (m/s), and wave number k (1/m)


WaterWindow: TypeAlias = tuple[Array, Array, Array, Array, Array]
"""Water column at M instants between the same two samples, for compiled code: the first three fields of
``WaterSample``, the time weights (M,) and the waves (M, 3).
"""


class _Walk:
    """Random walk q W on one side of t = 0, sampled at whole seconds; each sample has shape (K, 2)."""

    def __init__(self, seed: int, stream: Stream, cells: int, change: float) -> None:
        self._seed, self._stream, self._shape, self._change = seed, stream, (cells, 2), change
        self._restart()

    def _restart(self) -> None:
        self._draws = generator(self._seed, self._stream)
        self._last, self._value = 0, np.zeros(self._shape)
        self._cache = {0: self._value}

    def at(self, second: int) -> Array:
        """Return the sample at a distance of ``second`` >= 0 whole seconds from t = 0."""
        if second <= self._last and second not in self._cache:
            self._restart()
        while self._last < second:
            self._value = self._value + self._change * self._draws.standard_normal(self._shape)
            self._last += 1
            remember(self._cache, self._last, self._value, _MAX_CACHED)
        return self._cache[second]


class WaterFeature(Protocol):
    """Feature of the water: a velocity that is added to a column."""

    steady: bool  # constant in time

    def depths(self, own_m: Array) -> Array:
        """Return the depths (m) between which column and feature together are linear, strictly increasing, (K,)."""
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
        feature: WaterFeature | None = None,
        waves: SurfaceWaves | None = None,
    ) -> None:
        """Build the column from its profile at t = 0.

        Parameters
        ----------
        depth_m : (K,) depths of the cells, strictly increasing.
        velocity_mps : (K, 2) velocity north and east at t = 0.
        change_mps_per_rts : q of the random walk (m/s per sqrt(s)); with 0 the column draws no random number.
        seed : seed of the run.
        feature : is added to the column. If it is steady or None, and q is 0, the column is constant in time.
        waves : their orbital velocity is added to the column.
        """
        self._cell_depth = np.ascontiguousarray(depth_m, dtype=np.float64)
        self._cell_velocity = np.ascontiguousarray(velocity_mps, dtype=np.float64)
        if self._cell_velocity.shape != (len(self._cell_depth), 2) or len(self._cell_depth) == 0:
            raise ValueError(
                f"depths {self._cell_depth.shape} and velocities {self._cell_velocity.shape} do not match: "
                "give shapes (K,) and (K, 2), K at least 1"
            )
        self._feature, self._waves = feature, waves
        self._depth = self._cell_depth if feature is None else feature.depths(self._cell_depth)
        self._has_walk = change_mps_per_rts != 0.0
        self._steady = not self._has_walk and (feature is None or feature.steady)
        cells = len(self._cell_depth)
        self._walk_after = _Walk(seed, Stream.WATER_CHANGE_AFTER, cells, change_mps_per_rts)
        self._walk_before = _Walk(seed, Stream.WATER_CHANGE_BEFORE, cells, change_mps_per_rts)
        self._second = 0
        first = self._at_second(0)
        self._ends = (first, first) if self._steady else (first, self._at_second(1))

    @property
    def depth_m(self) -> Array:
        """Depths (m) between which the current is linear: centres of the cells and depths of the feature, (K,)."""
        return self._depth

    def _at_second(self, second: int) -> Array:
        """Return the velocities (K, 2) at a whole second, at the depths of ``depth_m``."""
        c = self._cell_velocity
        if self._has_walk:
            c = c + (self._walk_after.at(second) if second >= 0 else self._walk_before.at(-second))
        if self._feature is None:
            return c
        north, east = (np.interp(self._depth, self._cell_depth, axis) for axis in c.T)
        return np.column_stack([north, east]) + self._feature.velocity(self._depth, float(second))

    def sample(self, t_ns: int) -> WaterSample:
        """Return the column at ``t_ns``, for compiled code."""
        wave = (0.0, 0.0, 0.0) if self._waves is None else self._waves.at(t_ns)
        if self._steady:
            return WaterSample(self._depth, self._ends[0], self._ends[0], 0.0, wave)
        second = t_ns // SAMPLE_PERIOD_NS
        if second != self._second:
            self._second, self._ends = second, (self._at_second(second), self._at_second(second + 1))
        time_weight = (t_ns - second * SAMPLE_PERIOD_NS) / SAMPLE_PERIOD_NS
        return WaterSample(self._depth, self._ends[0], self._ends[1], time_weight, wave)

    def window(self, times_ns: Sequence[int]) -> WaterWindow:
        """Return the column at several times, for compiled code; they all lie in [s, s + 1) for one whole second s."""
        depth, earlier, later, _, _ = self.sample(times_ns[0])
        if self._steady and self._waves is None:
            return depth, earlier, later, np.zeros(len(times_ns)), np.zeros((len(times_ns), 3))
        samples = [self.sample(t_ns) for t_ns in times_ns]
        return depth, earlier, later, np.array([s.time_weight for s in samples]), np.array([s.wave for s in samples])

    def at(self, depth_m: float, t_ns: int) -> Pair:
        """Return the velocity north and east (m/s) at one depth."""
        return water_at(depth_m, self.sample(t_ns))[:2]

    def gradient(self, depth_m: float, t_ns: int) -> Pair:
        """Return dc/dz (1/s), north and east: 0 beyond both ends; at a grid point the gradient just below it."""
        return water_at(depth_m, self.sample(t_ns))[2:]

    def over(self, depths_m: Array, t_ns: int) -> Array:
        """Return the velocities (m/s) at depths (J,), shape (J, 2)."""
        return velocities_at_depths(np.ascontiguousarray(depths_m, dtype=np.float64), self.sample(t_ns))

    def profile(self, t_ns: int) -> CurrentProfile:
        """Return the column at ``t_ns`` as a current profile."""
        _, earlier, later, time_weight, _ = self.sample(t_ns)
        now = earlier + time_weight * (later - earlier)
        return CurrentProfile(depth_m=self._depth.copy(), north_mps=now[:, 0].copy(), east_mps=now[:, 1].copy())


@jit
def water_at(depth: float, water: WaterSample) -> tuple[float, float, float, float]:
    """Return the velocity (m/s) and its gradient dc/dz (1/s) at a depth, north and east each.

    The velocity is linear in depth and in time. Beyond both ends the gradient is 0, but for that of the waves; at a
    grid point it is the one just below.
    """
    depths, earlier, later, time_weight = water.depth_m, water.earlier, water.later, water.time_weight
    k = count_up_to(depths, depth) - 1  # the last grid point above, -1 above the first
    a, b = max(k, 0), min(k + 1, len(depths) - 1)
    step = depths[b] - depths[a]  # 0 above the first and below the last grid point
    depth_weight = (depth - depths[a]) / step if step > 0.0 else 0.0
    by_north, by_east = earlier[b, 0] - earlier[a, 0], earlier[b, 1] - earlier[a, 1]
    north, east = earlier[a, 0] + depth_weight * by_north, earlier[a, 1] + depth_weight * by_east
    # A branch that skips these lines for a time weight of 0 would cost more time than it saves: numba would then count
    # the references to ``later`` on both paths.
    later_north, later_east = later[b, 0] - later[a, 0], later[b, 1] - later[a, 1]
    north += time_weight * (later[a, 0] + depth_weight * later_north - north)
    east += time_weight * (later[a, 1] + depth_weight * later_east - east)
    by_north += time_weight * (later_north - by_north)
    by_east += time_weight * (later_east - by_east)
    by_north, by_east = (by_north / step if step > 0.0 else 0.0), (by_east / step if step > 0.0 else 0.0)
    wave_north, wave_east, number = water.wave
    if number > 0.0:
        decay = math.exp(-number * max(depth, 0.0))
        north, east = north + decay * wave_north, east + decay * wave_east
        by_north, by_east = by_north - number * decay * wave_north, by_east - number * decay * wave_east
    return north, east, by_north, by_east


@jit
def velocities_at_depths(depths: Array, water: WaterSample) -> Array:
    """Return the velocity at each of the ``depths`` (J,), shape (J, 2)."""
    c = np.empty((len(depths), 2))
    for j in range(len(depths)):
        c[j, 0], c[j, 1], _, _ = water_at(depths[j], water)
    return c
