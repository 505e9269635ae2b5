"""Delay from the start of a cycle to the arrival of its plan at the actuators.

It is measured from the actuators' receipts of plans, if they report any: computing, publishing and transport together.
Without receipts it is the cycle's computing time alone. With m the median and h a high quantile of the last
``WINDOW_CYCLES`` measurements, the expected delay is

    max(h + (h - m), min_ns)

so that a plan is rarely late, and a delay that never varies is expected as it is. An expectation that is too long costs
little, because the vehicle's motion until then is predicted. A receipt after the end of the plan is not counted: the
actuators do not follow such a plan, so a stamp is wrong.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

from ltv_mpc.messages import Applied, CycleTiming

WINDOW_CYCLES = 100
"""Number of measurements in use: 30 s at the default period."""


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
        self.expected_ns = max(first_ns, min_ns)
        """Expected time from the start of a cycle to its plan's arrival (ns)."""
        self._quantile = quantile
        self._min_ns = min_ns
        self._plan_ns = plan_ns
        self._receipts: deque[int] = deque(maxlen=WINDOW_CYCLES)
        self._computing: deque[int] = deque(maxlen=WINDOW_CYCLES)
        self._last_receipt: int | None = None  # start of the cycle whose receipt came last

    def save(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the measured delays until the plans' arrival, and the computing times (ns)."""
        return tuple(self._receipts), tuple(self._computing)

    def restore(self, first_ns: int, receipts: Iterable[int], computing: Iterable[int]) -> None:
        """Begin again, from the measurements of another controller.

        Parameters
        ----------
        first_ns : expected if there are no measurements (ns).
        receipts : delays until the plans' arrival (ns).
        computing : computing times (ns).
        """
        self.expected_ns = max(first_ns, self._min_ns)
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
            self._receipts.append(took_ns)
            self._update()

    def add_timing(self, timing: CycleTiming) -> None:
        """Take in the computing time of the last cycle.

        Parameters
        ----------
        timing : ``compute_ns`` is used.
        """
        self._computing.append(timing.compute_ns)
        self._update()

    def _update(self) -> None:
        """Compute the expected delay from all measurements; it is called between cycles, not within one."""
        in_order = sorted(self._receipts or self._computing)
        median, high = (in_order[math.ceil(share * (len(in_order) - 1))] for share in (0.5, self._quantile))
        self.expected_ns = max(high + (high - median), self._min_ns)
