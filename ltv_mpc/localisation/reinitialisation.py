"""Reinitialisation: a filter that has diverged is replaced by one that starts from its last good position.

Good    Once a second position and velocity are stored with their covariance. If innovations have been inconsistent for
        ``MAX_INCONSISTENT_NS``, the last good instant is one window of the health monitor before they became so,
        because that window was affected already.
Start   As at the surface, by ``Alignment``, with an artificial fix in place of the satellites':
            p = p_g + v_g t,   sd_p^2 = P_pp + (sd_v t)^2      t since the good instant
            v = v_g,           sd_v = 0.3 m/s                  half the top speed, which a vehicle may have reached
        The level comes from the accelerometers with 0.1 m/s2 of motion, the heading from the compass. Biases are as at
        the start.
Water   Water and profiler states are those of a belief at or before the good instant, with their covariance
        (``restore_water``). The first pings then determine the velocity over ground as well as before. With unknown
        water 0.1 m/s of it would stay unknown for the rest of the dive.
        If the last reinitialisation was a short time ago, the water may be the cause: then it is as at the start.
Time    The new filter starts at the last heading that 0.2 s of samples have followed, at most a second ago, and applies
        the measurements since, so estimates have no gap. Without a recent heading the old filter continues until a
        heading, a pressure and samples have arrived.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation import current_model
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.alignment import LEVELLING_NS, Alignment
from ltv_mpc.localisation.filter.state import Belief
from ltv_mpc.localisation.health import WINDOW_NS
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.sensor import Measurement
from ltv_mpc.messages import Array, CompassHeading, FilterStatus, GnssFix, ImuSample

MAX_INCONSISTENT_NS = 10_000_000_000
RESTARTED_NS = 30_000_000_000
"""Time for which the filter is reported as restarted."""
SAME_CAUSE_NS = 120_000_000_000
"""A second reinitialisation within this time is taken to have the same cause."""
VELOCITY_SD_MPS = 0.3
ACCELERATION_SD_MPS2 = 0.1
_MAX_POSITIONS = 60
BELIEF_NS = 5_000_000_000
"""Time between two beliefs that are stored with their whole covariance."""

_SPARE_NS = 50_000_000
"""Longer than a sample, so that the samples between the heading and now cover the time of levelling."""


class GoodPosition(NamedTuple):
    """Position and velocity of a consistent filter, north and east."""

    t_ns: int
    position_m: Array  # (2,)
    velocity_mps: Array  # (2,)
    variance_m2: float  # of the position, the larger one of both axes


def is_finite(belief: Belief) -> bool:
    """Return True if a few entries of the belief are finite, a quick check for every message.

    Any other entry that is not finite reaches these by the next message.
    """
    x, P = belief.x.item, belief.P.item  # plain floats: a third of the time
    return math.isfinite(x(0) + x(2) + x(3) + x(5) + P(0, 0) + P(2, 2) + P(3, 3))


def is_usable(belief: Belief) -> bool:
    """Return True if the whole belief is finite and no variance is negative."""
    return bool(np.isfinite(belief.x).all() and np.isfinite(belief.P).all() and (np.diagonal(belief.P) >= 0).all())


class Reinitialisation:
    """Past of the active filter, and the start of the filter that replaces it."""

    def __init__(self, sensor_config: SensorConfig, config: EstimatorConfig, prior: WaterPrior | None) -> None:
        """Create a reinitialisation without a past.

        Parameters
        ----------
        sensor_config : settings of the sensors.
        config : settings of the filter.
        prior : water known from an earlier dive; None: that of ``config``.
        """
        self.count = 0
        self.inconsistent_since_ns: int | None = None
        self._sensor_config, self._config, self._prior = sensor_config, config, prior
        self._positions: deque[GoodPosition] = deque(maxlen=_MAX_POSITIONS)
        self._last_ns: int | None = None
        self._beliefs: deque[Belief] = deque(maxlen=_MAX_POSITIONS * 1_000_000_000 // BELIEF_NS)
        self._known: Belief | None = None  # the next filter takes its water from it

    @property
    def has_good_position(self) -> bool:
        """True if a position is stored, without which no filter can start."""
        return bool(self._positions)

    @property
    def is_inconsistent(self) -> bool:
        """True while the innovations of the filter are inconsistent."""
        return self.inconsistent_since_ns is not None

    def recent(self, t_ns: int) -> bool:
        """Return True if a new filter has started within the last ``RESTARTED_NS`` before ``t_ns``.

        Parameters
        ----------
        t_ns : time of the report (ns).
        """
        return self._last_ns is not None and t_ns - self._last_ns < RESTARTED_NS

    def watch(self, belief: Belief, status: FilterStatus, *, broken: bool = False) -> bool:
        """Store the position of one second, and return True if the filter must be replaced.

        Parameters
        ----------
        belief : of the active filter.
        status : result of the health monitor.
        broken : a covariance of innovations is not positive definite; the filter must be replaced at once.
        """
        t_ns = belief.t_ns
        if broken or not is_usable(belief):
            return self.has_good_position
        if status is FilterStatus.NOMINAL:
            self.inconsistent_since_ns = None
        elif self.inconsistent_since_ns is None:
            self.inconsistent_since_ns = t_ns
        x, P = belief.x, belief.P
        variance = float(max(P[0, 0], P[1, 1]))
        self._positions.append(GoodPosition(t_ns, x[:2].copy(), x[3:5].copy(), variance))
        return self.inconsistent_since_ns is not None and t_ns - self.inconsistent_since_ns >= MAX_INCONSISTENT_NS

    def is_belief_due(self, t_ns: int) -> bool:
        """Return True if the whole belief of a consistent filter is to be stored at ``t_ns``.

        Parameters
        ----------
        t_ns : time of the report (ns).
        """
        return not self.is_inconsistent and (not self._beliefs or t_ns - self._beliefs[-1].t_ns >= BELIEF_NS)

    def store(self, belief: Belief) -> None:
        """Store a belief whose covariance stands at its time.

        Parameters
        ----------
        belief : of a consistent filter.
        """
        self._beliefs.append(belief)

    def begin(self, now_ns: int, recent: Sequence[ImuSample | Measurement]) -> Alignment:
        """Return the alignment of a new filter.

        Parameters
        ----------
        now_ns : time of the filter that has diverged (ns).
        recent : messages of the last seconds, in order of arrival.

        Returns
        -------
        An alignment that has received the recent messages. It may need further ones (``Alignment.waiting_for``).
        """
        t_ns = _start(now_ns, recent)
        good = self._good(now_ns)
        soon = self._last_ns is not None and now_ns - self._last_ns < SAME_CAUSE_NS
        before = [belief for belief in self._beliefs if belief.t_ns <= good.t_ns]
        self._known = before[-1] if before and not soon else None
        self._beliefs.clear()
        self.count += 1
        self._last_ns = now_ns
        self.inconsistent_since_ns = None
        elapsed_s = (t_ns - good.t_ns) * 1e-9
        replace, sensor_config = msgspec.structs.replace, self._sensor_config
        sd_m = math.hypot(math.sqrt(good.variance_m2), VELOCITY_SD_MPS * elapsed_s)
        gnss = replace(
            sensor_config.gnss, position_sd_m=sd_m, velocity_sd_mps=VELOCITY_SD_MPS, lever_arm_m=(0.0, 0.0, 0.0)
        )
        config = replace(self._config, afloat_acceleration_sd_mps2=ACCELERATION_SD_MPS2)
        alignment = Alignment(replace(sensor_config, gnss=gnss), config, self._prior)
        north, east = (good.position_m + good.velocity_mps * elapsed_s).tolist()
        v_north, v_east = good.velocity_mps.tolist()
        alignment.take(
            GnssFix(t_ns=t_ns, north_m=north, east_m=east, velocity_north_mps=v_north, velocity_east_mps=v_east)
        )
        self._positions.clear()
        self._positions.append(GoodPosition(t_ns, np.array([north, east]), good.velocity_mps, sd_m**2))
        for message in recent:
            if message.t_ns >= t_ns and not isinstance(message, GnssFix):
                alignment.take(message)
        return alignment

    def fork(self) -> Reinitialisation:
        """Return a copy for a filter whose innovations have just become inconsistent, and may be right nevertheless."""
        other = copy.copy(self)
        other._positions, other._beliefs = self._positions.copy(), self._beliefs.copy()
        other.inconsistent_since_ns = None
        return other

    def restore_water(self, belief: Belief) -> bool:
        """Copy the water and profiler states of the last good belief, with their covariance, into a new belief.

        Their covariance with the vehicle's states is set to zero.

        Parameters
        ----------
        belief : the new filter's first belief; changed in place.

        Returns
        -------
        False if there is no good belief, or if the water must be as at the start; then nothing is changed.
        """
        known = self._known
        if known is None:
            return False
        layout = belief.layout
        parts = (layout.beam_bias, layout.near_bias, layout.mounting, layout.mean, layout.north, layout.east)
        indices = np.concatenate([np.arange(part.start, part.stop) for part in parts])
        belief.x[indices] = known.x[indices]
        belief.P[indices, :] = 0.0
        belief.P[:, indices] = 0.0
        belief.P[np.ix_(indices, indices)] = known.P[np.ix_(indices, indices)]
        belief.mounting = known.mounting.copy()
        current_model.add_random_walk(belief, self._config, (belief.t_ns - known.t_ns) * 1e-9)
        return True

    def _good(self, t_ns: int) -> GoodPosition:
        """Return the newest position before the window that was affected, or the oldest one."""
        since_ns = t_ns if self.inconsistent_since_ns is None else self.inconsistent_since_ns
        before = [position for position in self._positions if position.t_ns <= since_ns - WINDOW_NS]
        return before[-1] if before else self._positions[0]


def _start(now_ns: int, recent: Sequence[ImuSample | Measurement]) -> int:
    """Return the start time of the new filter (ns): the last heading that enough samples have followed, or now."""
    headings = [m.t_ns for m in recent if isinstance(m, CompassHeading) and m.t_ns <= now_ns - LEVELLING_NS - _SPARE_NS]
    return max(headings, default=now_ns)
