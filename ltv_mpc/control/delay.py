"""Delay from the start of a cycle to the arrival of its plan at the actuators.

It is measured from the actuators' receipts of plans, if they report any: computing, publishing and transport together.
Without receipts it is the cycle's computing time alone. With m the median, u the quantile ``USUAL`` and h a high
quantile of the last ``WINDOW_CYCLES`` measurements, the expected delay is

    max(min(h + (h - m), m + FARTHEST (u - m)), min_ns)

so that a plan is rarely late, and a delay that never varies is expected as it is. The second term leaves out rare
delays that are much longer than the usual ones: the actuators start such a plan where it is due, and to expect them
costs every cycle a longer prediction, with the errors of the model. A receipt after the end of the plan is not counted:
the actuators do not follow such a plan, so a stamp is wrong. After ``LONGER`` measurements in a row above the expected
delay, or ``SHORTER`` below the median, the delay has changed, and older ones are dropped
(docs/notes/control-studies.md).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

from ltv_mpc.messages import Applied, CycleTiming

WINDOW_CYCLES = 100
"""Number of measurements in use: 30 s at the default period."""

USUAL, FARTHEST = 0.85, 5.0
LONGER, SHORTER = 5, 20


class Delay:
    """Expected delay of a plan, in vehicle time."""

    def __init__(self, first_ns: int, quantile: float, min_ns: int = 0, plan_ns: float = math.inf) -> None:
        """Begin without measurements.

        Parameters
        ----------
        first_ns : expected before anything was measured (ns).
        quantile : h is this quantile of the measurements, 0.5 to 1.
        min_ns : lower bound of what is expected (ns).
        plan_ns : time for which a plan is followed (ns); a longer delay until a receipt is not counted.
        """
        self.expected_ns = self._first_ns = max(first_ns, min_ns)
        """Expected time from the start of a cycle to its plan's arrival (ns)."""
        self._quantile = quantile
        self._min_ns = min_ns
        self._plan_ns = plan_ns
        self._receipts: deque[int] = deque(maxlen=WINDOW_CYCLES)
        self._computing: deque[int] = deque(maxlen=WINDOW_CYCLES)
        self._last_receipt: int | None = None  # start of the cycle whose receipt came last
        self._usual_ns, self._median_ns = math.inf, 0  # expected without the lower bound, and the median
        self._longer = self._shorter = 0  # measurements in a row

    def save(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the measured delays until the plans' arrival, and the computing times (ns)."""
        return tuple(self._receipts), tuple(self._computing)

    def restore(self, expected_ns: int, receipts: Iterable[int], computing: Iterable[int]) -> None:
        """Begin again, from the measurements of another controller.

        Parameters
        ----------
        expected_ns : by that controller (ns); if there are no measurements, at least this is expected.
        receipts : delays until the plans' arrival (ns).
        computing : computing times (ns).
        """
        self.expected_ns = max(expected_ns, self._first_ns)
        self._receipts = deque(receipts, WINDOW_CYCLES)
        self._computing = deque(computing, WINDOW_CYCLES)
        self._last_receipt = None
        if self._receipts or self._computing:
            self._update()

    def add_receipt(self, applied: Applied) -> None:
        """Take in the arrival of a plan.

        Parameters
        ----------
        applied : report of the actuators; one without a plan, or of the same plan again, changes nothing.
        """
        if applied.plan_sequence < 0 or applied.plan_cycle_t_ns == self._last_receipt:
            return
        self._last_receipt = applied.plan_cycle_t_ns
        took_ns = max(applied.plan_received_t_ns - applied.plan_cycle_t_ns, 0)
        if took_ns <= self._plan_ns:
            self._add(self._receipts, took_ns)

    def add_timing(self, timing: CycleTiming) -> None:
        """Take in the computing time of the last cycle.

        Parameters
        ----------
        timing : ``compute_ns`` is used.
        """
        self._add(self._computing, timing.compute_ns)

    def _add(self, measured: deque[int], took_ns: int) -> None:
        """Add a measurement, and drop the ones before it if the delay has changed."""
        measured.append(took_ns)
        if measured is self._computing and self._receipts:
            return
        self._longer = self._longer + 1 if took_ns > self._usual_ns else 0
        self._shorter = self._shorter + 1 if took_ns < self._median_ns else 0
        for count, limit in ((self._longer, LONGER), (self._shorter, SHORTER)):
            while count >= limit and len(measured) > limit:
                measured.popleft()
        self._update()

    def _update(self) -> None:
        """Compute the expected delay from all measurements; it is called between cycles, not within one."""
        in_order = sorted(self._receipts or self._computing)
        median, usual, high = (
            in_order[math.ceil(share * (len(in_order) - 1))] for share in (0.5, USUAL, self._quantile)
        )
        self._median_ns = median
        self._usual_ns = min(high + (high - median), median + FARTHEST * (usual - median))
        self.expected_ns = max(round(self._usual_ns), self._min_ns)
