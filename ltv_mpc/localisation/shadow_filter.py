"""Shadow filter: a copy of the filter, taken when innovations first became inconsistent, that may replace it.

Inconsistent innovations do not show which side is wrong. If an ADCP is wrong for ten seconds it is rejected, and the
IMU alone determines the vehicle well. But a filter whose process noise is inflated meanwhile, or a new filter with an
uncertain velocity, may believe the ADCP. So a copy receives the same measurements from the first inconsistency on, and
never inflates its noise. If the essential sensors agree with the copy again while the active
filter is inconsistent or new, the sensor was wrong, and the copy takes over. Benefit: docs/notes/ablation.md.

Agreement  Of each essential sensor the last ``MIN_AGREEING`` messages pass the gate with ``MIN_ACCEPTED`` of their
           rows, within ``MAX_AGE_NS``, and at least one message did not pass before. A filter that was wrong does not
           reach this by waiting, because a measurement that it rejects cannot correct it. If innovations are too large
           but pass, nothing has been rejected, and there is nothing to return to.
Better     The copy replaces the active filter only if its state differs and its velocity is about as certain. The
           copy keeps process noise inflated earlier. A reinitialised filter with the earlier water profile can be more
           certain, so both velocity variances are compared.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter, Innovations
from ltv_mpc.localisation.filter.state import VELOCITY
from ltv_mpc.localisation.health import ESSENTIAL
from ltv_mpc.localisation.out_of_sequence import MeasurementBuffer
from ltv_mpc.localisation.reinitialisation import Reinitialisation
from ltv_mpc.localisation.sensors.sensor import Measurement

MAX_AGE_NS = 60_000_000_000
"""Vehicle time after which the copy is discarded."""

MIN_AGREEING = 3
"""Number of the last messages of a sensor that must agree."""

MIN_ACCEPTED = 0.8
"""Minimum share of a message's rows within the gate for the message to agree."""

MAX_ACCEPTED_IF_REJECTED = 0.5
"""Share of a message's rows within the gate below which the copy has rejected the message: most of it is wrong, not a
few outliers.
"""

MAX_SD_RATIO = 2.0
"""Maximum standard deviation of the copy's velocity over that of the active filter."""

REQUIRED = ("adcp", "pressure")
"""Essential sensors that the agreement requires. Bottom track may be absent: the bottom can be out of range."""


class ShadowFilter(MeasurementBuffer):
    """Copy of a filter that follows the active one step by step, with a buffer of its own."""

    def __init__(self, filter_: ErrorStateFilter, past: Reinitialisation) -> None:
        """Copy a filter whose innovations have just become inconsistent.

        Parameters
        ----------
        filter_ : the active filter.
        past : its good positions and beliefs up to now, for the time after the copy has taken over.
        """
        super().__init__(filter_.fork())
        self.filter.observers.append(self._observe)
        self.past = past
        self._until_ns = self.filter.belief.t_ns + MAX_AGE_NS
        self._has_rejected = False
        self._agreed: dict[str, deque[bool]] = {name: deque(maxlen=MIN_AGREEING) for name in ESSENTIAL}

    @property
    def expired(self) -> bool:
        """True if the copy is older than ``MAX_AGE_NS``."""
        return self.filter.belief.t_ns >= self._until_ns

    @property
    def agrees(self) -> bool:
        """True if the essential sensors agree with the copy, after it has rejected a message."""
        enough = all(len(self._agreed[name]) == MIN_AGREEING for name in REQUIRED)
        return self._has_rejected and enough and all(all(agreed) for agreed in self._agreed.values())

    def is_better_than(self, current: ErrorStateFilter) -> bool:
        """Return True if the copy, which agrees, differs from ``current`` and its velocity is about as certain.

        Parameters
        ----------
        current : the active filter, at the same time.
        """
        own_variance, active_variance = (
            np.trace(f.core_covariance()[VELOCITY, VELOCITY]) for f in (self.filter, current)
        )
        return bool(own_variance <= MAX_SD_RATIO**2 * active_variance) and not np.array_equal(
            self.filter.belief.x, current.belief.x
        )

    def use(self, message: Measurement) -> None:
        """Correct the copy by a measurement of its own time, or by a late one that it can still use.

        Parameters
        ----------
        message : measurement that the active filter uses too.
        """
        if message.t_ns == self.filter.belief.t_ns or self.is_within_reach(message.t_ns):
            super().use(message)

    def _observe(self, innovations: Innovations) -> None:
        if innovations.sensor in self._agreed and len(innovations.accepted):
            passed = float(innovations.accepted.mean()) if innovations.definite else 0.0
            self._agreed[innovations.sensor].append(passed >= MIN_ACCEPTED)
            self._has_rejected = self._has_rejected or passed < MAX_ACCEPTED_IF_REJECTED
