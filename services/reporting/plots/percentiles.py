"""Percentiles of durations from a histogram of constant size: bins of equal width on a logarithmic axis."""

from __future__ import annotations

import math

BINS_PER_DECADE = 100  # 2.3 % of resolution
LOW_MS, DECADES = 1e-3, 8  # 1 us to 100 s


class Percentiles:
    """Histogram of durations (ms) with their maximum."""

    def __init__(self) -> None:
        self._counts = [0] * (BINS_PER_DECADE * DECADES)
        self._total = 0
        self.max_ms = 0.0

    def add(self, ms: float | None) -> None:
        """Add a duration; None and durations that are not positive are ignored."""
        if ms is None or ms <= 0.0:
            return
        i = int(BINS_PER_DECADE * math.log10(ms / LOW_MS)) if ms > LOW_MS else 0
        self._counts[min(i, len(self._counts) - 1)] += 1
        self._total += 1
        self.max_ms = max(self.max_ms, ms)

    def at(self, share: float) -> float | None:
        """Return the duration (ms) that ``share`` of all do not exceed; None without durations."""
        left = share * self._total
        for i, count in enumerate(self._counts):
            left -= count
            if count and left <= 0.0:
                return min(LOW_MS * math.exp((i + 0.5) / BINS_PER_DECADE * math.log(10.0)), self.max_ms)
        return None
