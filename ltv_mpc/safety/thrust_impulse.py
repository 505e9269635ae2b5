"""Impulse of the reported thrusts of port and starboard, up to any time within the last seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from ltv_mpc.messages import Applied, Pair

KEPT_NS = 5_000_000_000
"""Age up to which reports are kept. An estimate that arrives later than this is not compared with the model."""


class ThrustImpulse:
    """Integral of the reported thrusts of port and starboard over time."""

    def __init__(self) -> None:
        self._reports: deque[tuple[int, Pair, Pair]] = deque()  # time, thrusts, impulses up to that time

    def add(self, applied: Applied) -> None:
        """Add a report of the actuators.

        Parameters
        ----------
        applied : the report.
        """
        thrust = applied.thrust_N[:2]
        if not self._reports:
            self._reports.append((applied.t_ns, thrust, (0.0, 0.0)))
            return
        t_ns, before, impulse = self._reports[-1]
        half_s = 0.5e-9 * (applied.t_ns - t_ns)
        if half_s > 0.0:
            at = impulse[0] + half_s * (before[0] + thrust[0]), impulse[1] + half_s * (before[1] + thrust[1])
            self._reports.append((applied.t_ns, thrust, at))
            while self._reports[1][0] <= applied.t_ns - KEPT_NS:
                self._reports.popleft()

    def until(self, t_ns: int) -> Pair | None:
        """Return the impulses (N s) up to ``t_ns``; None before the oldest report that is kept.

        Parameters
        ----------
        t_ns : time (ns).
        """
        found = self.until_each([t_ns])
        return None if found is None else found[0]

    def until_each(self, times_ns: Iterable[int]) -> list[Pair] | None:
        """Return the impulses (N s) up to each of some times; None if one is before the oldest report that is kept.

        The thrust is linear between reports and constant after the last one.

        Parameters
        ----------
        times_ns : times (ns), the latest first.
        """
        reports, found = self._reports, []
        k = len(reports) - 1
        for t_ns in times_ns:
            while k >= 0 and reports[k][0] > t_ns:
                k -= 1
            if k < 0:
                return None
            at, (f1, f2), (i1, i2) = reports[k]
            s = (t_ns - at) * 1e-9
            if k + 1 < len(reports):
                then, (g1, g2), _ = reports[k + 1]
                half = 0.5 * s * s / ((then - at) * 1e-9)
                found.append((i1 + s * f1 + half * (g1 - f1), i2 + s * f2 + half * (g2 - f2)))
            else:
                found.append((i1 + s * f1, i2 + s * f2))
        return found
