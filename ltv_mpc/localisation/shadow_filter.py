"""A filter as it was when it began to be doubted goes on unheard beside the one in use: it may have been right.

Innovations out of their band do not say whose fault it is. A profiler that is wrong for ten seconds is refused, and the
vehicle is known by its inertial unit, well; but what is granted to the water or the unit meanwhile, or a new filter
that is unsure of its velocity, may believe it. So a twin that grants nothing is given everything that is heard from
the first doubt on: where what ties velocity and depth down agrees with it again while the filter in use is doubted or
new, it was the instrument, and the twin takes its place.

Agrees  of each tie the last ``MIN_AGREEING`` messages have passed the gate, ``MIN_ACCEPTED`` of their rows, within
        ``MAX_AGE_NS``, and at least one had not before. A filter that was wrong does not come to that by waiting: what
        it refuses cannot correct it. One whose innovations are too large, and pass, has refused nothing and has
        nothing to come back to.
Worth   more than the one in use it is only where it has come to something else, and is about as sure of its velocity.
        What was granted before the doubt it has too: a filter that begins anew with the water as it was known may well
        be the better one then.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter, Innovations
from ltv_mpc.localisation.filter.state import VELOCITY
from ltv_mpc.localisation.health import ESSENTIAL
from ltv_mpc.localisation.out_of_sequence import MeasurementBuffer
from ltv_mpc.localisation.reinitialisation import PastBeliefs
from ltv_mpc.localisation.sensors.sensor import Measurement
from ltv_mpc.messages import ImuSample

MAX_AGE_NS = 60_000_000_000
MIN_AGREEING = 3
MIN_ACCEPTED = 0.8
MAX_SD_RATIO = 2.0
"""Times the standard deviation of the velocity of the one in use, at most."""
REQUIRED = ("adcp", "pressure")
"""A bottom that is out of range is not asked."""


class ShadowFilter:
    """Stands at the same time as the filter in use, step by step."""

    def __init__(self, filter_: ErrorStateFilter, spacing_ns: int, past_beliefs: PastBeliefs) -> None:
        """``filter_`` has begun to be doubted; ``past_beliefs``: of the restarts before it."""
        twin = filter_.fork()
        twin.observers.append(self._hear)
        self._buffer = MeasurementBuffer(twin, spacing_ns)
        self.past_beliefs = past_beliefs
        self._until_ns = twin.belief.t_ns + MAX_AGE_NS
        self._has_refused = False
        self._agreed: dict[str, deque[bool]] = {name: deque(maxlen=MIN_AGREEING) for name in ESSENTIAL}

    @property
    def filter(self) -> ErrorStateFilter:
        """The twin."""
        return self._buffer.filter

    @property
    def expired(self) -> bool:
        """It has been refused for too long to be right yet."""
        return self.filter.belief.t_ns >= self._until_ns

    @property
    def agrees(self) -> bool:
        """With what it refused before."""
        enough = all(len(self._agreed[name]) == MIN_AGREEING for name in REQUIRED)
        return self._has_refused and enough and all(all(said) for said in self._agreed.values())

    def is_better_than(self, current: ErrorStateFilter) -> bool:
        """Than the filter in use, if it agrees."""
        own, others = (np.trace(f.core_covariance()[VELOCITY, VELOCITY]) for f in (self.filter, current))
        return bool(own <= MAX_SD_RATIO**2 * others) and not np.array_equal(self.filter.belief.x, current.belief.x)

    def advance(self, t_ns: int, sample: ImuSample) -> None:
        """As the other does."""
        self._buffer.advance(t_ns, sample)

    def use(self, message: Measurement) -> None:
        """Of its own time or a late one, if that is after its beginning."""
        if message.t_ns == self.filter.belief.t_ns or self._buffer.is_within_reach(message.t_ns):
            self._buffer.use(message)

    def _hear(self, verdict: Innovations) -> None:
        if verdict.sensor in self._agreed and len(verdict.accepted):
            passed = float(verdict.accepted.mean()) if verdict.definite else 0.0
            self._agreed[verdict.sensor].append(passed >= MIN_ACCEPTED)
            self._has_refused = self._has_refused or 2.0 * passed < 1.0
