"""How long until a plan takes effect: from the start of its cycle to its arrival at the actuators.

Measured, where the actuators report back, from the receipt of each plan (computing, publishing and transport at once);
else from the cycle's own computing time. Expected is a high quantile of what was measured lately, and as much again as
that lies above the median, and never less than a setting says: a plan is then rarely late, and a delay that never
varies is expected as it is. Being too careful costs little, since the vehicle's motion until then is predicted.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

from ltv_mpc.messages import Applied, CycleTiming

REMEMBERED = 100
"""Cycles: 30 s at the default period."""


class Delay:
    """Expected delay in vehicle nanoseconds."""

    def __init__(self, first_ns: int, quantile: float, min_ns: int = 0) -> None:
        self._expected_ns = max(first_ns, min_ns)
        self._quantile = quantile
        self._min_ns = min_ns
        self._receipts: deque[int] = deque(maxlen=REMEMBERED)
        self._computing: deque[int] = deque(maxlen=REMEMBERED)
        self._receipt_of: int | None = None  # the cycle whose receipt came last

    def save(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return what was measured (ns): until the plan's arrival, and computing alone."""
        return tuple(self._receipts), tuple(self._computing)

    def restore(self, receipts: Iterable[int], computing: Iterable[int]) -> None:
        """Continue from what another one has measured."""
        self._receipts.extend(receipts)
        self._computing.extend(computing)
        if self._receipts or self._computing:
            self._learn()

    def add_receipt(self, applied: Applied) -> None:
        """The actuators say which plan they got, and when."""
        if applied.plan_sequence < 0 or applied.plan_cycle_t_ns == self._receipt_of:
            return
        self._receipt_of = applied.plan_cycle_t_ns
        self._receipts.append(max(applied.plan_received_t_ns - applied.plan_cycle_t_ns, 0))
        self._learn()

    def add_timing(self, timing: CycleTiming) -> None:
        """What the last cycle took, without transport."""
        self._computing.append(timing.compute_ns)
        self._learn()

    def expected_ns(self) -> int:
        """From the start of a cycle to its plan's arrival."""
        return self._expected_ns

    def _learn(self) -> None:
        """Between cycles: what is expected from now on."""
        in_order = sorted(self._receipts or self._computing)
        middle, high = (in_order[math.ceil(share * (len(in_order) - 1))] for share in (0.5, self._quantile))
        self._expected_ns = max(high + (high - middle), self._min_ns)
