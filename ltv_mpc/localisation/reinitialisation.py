"""A filter that has diverged begins anew where it was last good.

Good    once a second position and velocity are kept, with their covariance. When innovations have been out of their
        band for ``MAX_INCONSISTENT_NS``, the last good instant is one window of the monitor before they left it: what
        the window averaged over was tainted already.
Anew    as afloat, by ``Alignment``, with a fix made of what is known in place of the satellites':
            p = p_g + v_g t,   sd_p^2 = P_pp + (sd_v t)^2      t since the good instant
            v = v_g,           sd_v = 0.3 m/s                   a vehicle may have got up to half its top speed
        level from the accelerometers with 0.1 m/s2 of motion, heading from the compass, biases as at the start.
Water   and what is known of the profiler as they were known at or before the good instant, with their covariance
        (``restore_water``): the first pings then tell the velocity over ground as well as it was ever told, where water
        that is unknown would leave 0.1 m/s of it open for the rest of the dive.
Again   What made the first filter diverge may be the water: where the last restart is not long ago, the water is as
        at the start.
Time    It begins at the time of the last heading that 0.2 s of samples have followed, a second ago at most, and is
        brought up to now by what has been measured since: estimates go on without a gap. Where no heading has come
        lately the old filter goes on until one does, and with it pressure and samples.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.alignment import LEVELLING_NS, Alignment
from ltv_mpc.localisation.filter.state import Belief
from ltv_mpc.localisation.health import WINDOW_NS
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.sensor import Measurement
from ltv_mpc.localisation.water import current_model
from ltv_mpc.messages import Array, CompassHeading, FilterStatus, GnssFix, ImuSample

MAX_INCONSISTENT_NS = 10_000_000_000
RESTARTED_NS = 30_000_000_000
"""It is said to have restarted for this long."""
SAME_CAUSE_NS = 120_000_000_000
"""A second restart within this time is of the same cause."""
VELOCITY_SD_MPS = 0.3
ACCELERATION_SD_MPS2 = 0.1
_KEPT = 60
BELIEF_NS = 5_000_000_000
"""Between two beliefs that are kept whole."""

_SPARE_NS = 50_000_000
"""More than a sample: the first after a heading and the last before now enclose the time of levelling."""


class GoodPosition(NamedTuple):
    """Where the vehicle was and how it moved, north and east."""

    t_ns: int
    position_m: Array  # (2,)
    velocity_mps: Array  # (2,)
    variance_m2: float  # of the worse of both axes


class PastBeliefs(NamedTuple):
    """What is known of a filter and of restarts before it, for one that comes back (``shadow_filter.py``)."""

    places: tuple[GoodPosition, ...]
    beliefs: tuple[Belief, ...]
    last_ns: int | None


def is_finite(belief: Belief) -> bool:
    """A quick look, for every message: what is not finite anywhere is not finite here by the next."""
    x, P = belief.x.item, belief.P.item  # plain floats: a third of the time
    return math.isfinite(x(0) + x(2) + x(3) + x(5) + P(0, 0) + P(2, 2) + P(3, 3))


def is_usable(belief: Belief) -> bool:
    """Finite, and no variance below zero."""
    return bool(np.isfinite(belief.x).all() and np.isfinite(belief.P).all() and (np.diagonal(belief.P) >= 0).all())


class Reinitialisation:
    """Watches one filter after the other; told of each second's verdict."""

    def __init__(self, suite: SensorConfig, config: EstimatorConfig, prior: WaterPrior | None) -> None:
        self.count = 0
        self._suite, self._config, self._prior = suite, config, prior
        self._places: deque[GoodPosition] = deque(maxlen=_KEPT)
        self._bad_since_ns: int | None = None
        self._last_ns: int | None = None
        self._beliefs: deque[Belief] = deque(maxlen=_KEPT * 1_000_000_000 // BELIEF_NS)
        self._known: Belief | None = None  # of which the next filter has its water

    @property
    def has_good_position(self) -> bool:
        """A good one; only then can a filter begin anew."""
        return bool(self._places)

    @property
    def is_inconsistent(self) -> bool:
        """The filter's innovations are out of their band."""
        return self._bad_since_ns is not None

    def became_inconsistent(self, t_ns: int) -> bool:
        """At this second."""
        return self._bad_since_ns == t_ns

    def recent(self, t_ns: int) -> bool:
        """It has begun anew a short while ago."""
        return self._last_ns is not None and t_ns - self._last_ns < RESTARTED_NS

    def watch(self, belief: Belief, status: FilterStatus, *, broken: bool = False) -> bool:
        """Take note of a second; true: the filter must begin anew. ``broken``: at once."""
        t_ns = belief.t_ns
        if broken or not is_usable(belief):
            return self.has_good_position
        if status is FilterStatus.NOMINAL:
            self._bad_since_ns = None
        elif self._bad_since_ns is None:
            self._bad_since_ns = t_ns
        x, P = belief.x, belief.P
        variance = float(max(P[0, 0], P[1, 1]))
        self._places.append(GoodPosition(t_ns, x[:2].copy(), x[3:5].copy(), variance))
        return self._bad_since_ns is not None and t_ns - self._bad_since_ns >= MAX_INCONSISTENT_NS

    def is_belief_due(self, t_ns: int) -> bool:
        """A whole one of a filter that is not in doubt."""
        return not self.is_inconsistent and (not self._beliefs or t_ns - self._beliefs[-1].t_ns >= BELIEF_NS)

    def store(self, belief: Belief) -> None:
        """A whole one, settled."""
        self._beliefs.append(belief)

    def begin(self, now_ns: int, recent: Sequence[ImuSample | Measurement]) -> Alignment:
        """What a new filter is made of, of what was heard recently; if that is not enough it is to be given more."""
        t_ns = _start(now_ns, recent)
        good = self._good(now_ns)
        soon = self._last_ns is not None and now_ns - self._last_ns < SAME_CAUSE_NS
        before = [belief for belief in self._beliefs if belief.t_ns <= good.t_ns]
        self._known = before[-1] if before and not soon else None
        self._beliefs.clear()
        self.count += 1
        self._last_ns = now_ns
        self._bad_since_ns = None
        gone_s = (t_ns - good.t_ns) * 1e-9
        replace, suite = msgspec.structs.replace, self._suite
        sd_m = math.hypot(math.sqrt(good.variance_m2), VELOCITY_SD_MPS * gone_s)
        gnss = replace(suite.gnss, position_sd_m=sd_m, velocity_sd_mps=VELOCITY_SD_MPS, lever_arm_m=(0.0, 0.0, 0.0))
        config = replace(self._config, afloat_acceleration_sd_mps2=ACCELERATION_SD_MPS2)
        alignment = Alignment(replace(suite, gnss=gnss), config, self._prior)
        north, east = (good.position_m + good.velocity_mps * gone_s).tolist()
        v_north, v_east = good.velocity_mps.tolist()
        alignment.take(
            GnssFix(t_ns=t_ns, north_m=north, east_m=east, velocity_north_mps=v_north, velocity_east_mps=v_east)
        )
        self._places.clear()
        self._places.append(GoodPosition(t_ns, np.array([north, east]), good.velocity_mps, sd_m**2))
        for message in recent:
            if message.t_ns >= t_ns and not isinstance(message, GnssFix):
                alignment.take(message)
        return alignment

    def past_beliefs(self) -> PastBeliefs:
        """Before a filter begins anew."""
        return PastBeliefs(tuple(self._places), tuple(self._beliefs), self._last_ns)

    def restore(self, past_beliefs: PastBeliefs) -> None:
        """That filter is believed again."""
        self._places = deque(past_beliefs.places, maxlen=_KEPT)
        self._beliefs = deque(past_beliefs.beliefs, maxlen=self._beliefs.maxlen)
        self._last_ns, self._bad_since_ns = past_beliefs.last_ns, None

    def restore_water(self, belief: Belief) -> bool:
        """Give ``belief``, which a new filter begins with, the water and the profiler of the last good one, as unsure
        as they were then, independent of how the vehicle moves; False: nothing is to be kept of it.
        """
        known = self._known
        if known is None:
            return False
        layout = belief.layout
        parts = (layout.beam_bias, layout.near_bias, layout.mounting, layout.mean, layout.north, layout.east)
        places = np.concatenate([np.arange(part.start, part.stop) for part in parts])
        belief.x[places] = known.x[places]
        belief.P[places, :] = 0.0
        belief.P[:, places] = 0.0
        belief.P[np.ix_(places, places)] = known.P[np.ix_(places, places)]
        belief.mounting = known.mounting.copy()
        belief.column = known.copy().column
        current_model.add_random_walk(belief, self._config, (belief.t_ns - known.t_ns) * 1e-9)
        return True

    def _good(self, t_ns: int) -> GoodPosition:
        """The newest place from before the window in which it went wrong, or the oldest there is."""
        since_ns = t_ns if self._bad_since_ns is None else self._bad_since_ns
        before = [place for place in self._places if place.t_ns <= since_ns - WINDOW_NS]
        return before[-1] if before else self._places[0]


def _start(now_ns: int, recent: Sequence[ImuSample | Measurement]) -> int:
    """Of the new filter: the last heading that enough samples have followed; now, if there is none."""
    headings = [m.t_ns for m in recent if isinstance(m, CompassHeading) and m.t_ns <= now_ns - LEVELLING_NS - _SPARE_NS]
    return max(headings, default=now_ns)
