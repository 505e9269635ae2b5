"""Delays of the control cycle: its time and deadline over time, and the percentiles of its stages."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping

from ltv_mpc.messages import Applied, Clock, CycleTiming, Plan
from services.reporting.plots.table import Columns, Table, short

PARTS = {
    "predict": ("read", "predict"),
    "linearise": ("linearise",),
    "build": ("build",),
    "solve": ("solve",),
    "publish": ("publish",),
}
"""Parts of ``CycleTiming.stage_us`` that each plotted stage sums."""

CYCLE, DELIVERY, AGE = "cycle", "cycle to actuators", "age of estimate"
STAGES = (*PARTS, CYCLE, DELIVERY, AGE)
"""Rows of the table ``stages``: wall time, but for the last two, which are vehicle time."""

BINS_PER_DECADE = 100  # 2.3 % of resolution


class Percentiles:
    """Histogram of durations (ms) with their maximum."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self.max_ms = 0.0

    def add(self, ms: float | None) -> None:
        """Add a duration; None and durations that are not positive are ignored."""
        if ms is not None and ms > 0.0:
            self._counts[math.floor(BINS_PER_DECADE * math.log10(ms))] += 1
            self.max_ms = max(self.max_ms, ms)

    def at(self, share: float) -> float | None:
        """Return the duration (ms) that ``share`` of all do not exceed; None without durations."""
        left = share * self._counts.total()
        for i in sorted(self._counts):
            left -= self._counts[i]
            if left <= 0.0:
                return min(math.pow(10.0, (i + 0.5) / BINS_PER_DECADE), self.max_ms)
        return None


class Delays:
    """Collector of durations. ``table`` takes each cycle; ``seconds`` converts a vehicle time (ns) to its axis."""

    def __init__(self, table: Table, seconds: Callable[[int], float]) -> None:
        self._table = table
        self._seconds = seconds
        self._stages = {name: Percentiles() for name in STAGES}
        self._received_ns = 0

    def add_applied(self, applied: Applied) -> None:
        """Add the arrival of a plan at the actuators."""
        if applied.plan_sequence >= 0 and applied.plan_received_t_ns != self._received_ns:
            self._received_ns = applied.plan_received_t_ns
            self._stages[DELIVERY].add((applied.plan_received_t_ns - applied.plan_cycle_t_ns) / 1e6)

    def add_timing(self, timing: CycleTiming, plan: Plan | None, clock: Clock | None) -> None:
        """Add the times of a cycle; plan and clock are the newest ones. Lock step measures no time."""
        cycle_ms = (timing.compute_wall_ns or timing.compute_ns) / 1e6
        if not cycle_ms:
            return
        deadline_ms = None
        if plan is not None and plan.cycle_t_ns == timing.t_ns:
            wall_per_vehicle = 1.0 if clock is None else clock.speed_den / clock.speed_num
            deadline_ms = (int(plan.t_ns[0]) - plan.cycle_t_ns) / 1e6 * wall_per_vehicle
        self._table.add(self._seconds(timing.t_ns), cycle_ms, deadline_ms or None)  # a logarithmic axis has no zero
        for name, parts in PARTS.items():
            self._stages[name].add(sum(timing.stage_us.get(part, 0.0) for part in parts) / 1e3)
        self._stages[CYCLE].add(cycle_ms)
        self._stages[AGE].add(timing.estimate_age_ns / 1e6)

    def stages(self) -> Columns:
        """Return median, 99th percentile and maximum of each stage (ms); empty if nothing was measured."""
        return {} if self._stages[CYCLE].at(1.0) is None else percentile_rows(self._stages)


def percentile_rows(stages: Mapping[str, Percentiles]) -> Columns:
    """Return the table ``stages``, one row for each of ``STAGES``; missing ones are empty."""
    rows = [stages.get(name, Percentiles()) for name in STAGES]
    return {
        "row": [float(i) for i in range(len(rows))],
        "median_ms": [short(row.at(0.5)) for row in rows],
        "p99_ms": [short(row.at(0.99)) for row in rows],
        "max_ms": [short(row.max_ms or None) for row in rows],
    }
