"""Health of the filter and of each sensor, from the innovations as they were before the gate.

Window  the last 10 s of each sensor: its rows, how many of them passed, and of those  x = r_i^2 / S_ii
NIS     mean x of the rows that passed over what chi-square truncated at the gate g has,
            E[x | x <= g] = F_3(g) / F_1(g),   F_k the distribution of chi-square of k degrees of freedom
        so that outliers do not make a good sensor look bad: they count as refused.
Band    of a sensor: chi-square of N degrees of freedom over N, at 1e-6 on either side. Rows of one message share the
        vehicle's error; the sum of their x has the variance 2 sum rho_ij^2, rho their correlation in S, so that m rows
        count as  N = m^2 / sum_ij rho_ij^2  independent ones (of a profiler some 50 of 56, 1500 in the window);
        messages of a consistent filter are independent. One false alarm in a week.
        Ranges and fixes from a ship come seldom and carry a second-order variance: for them only too large is wrong.
Refused more than half of the rows of the window, of at least two messages.
Filter  inconsistent when what ties its velocity or its depth down (profiler, bottom track, pressure) is refused, or
        has innovations ``GROSS_NIS`` times as large as said, or two sensors at once are: then it is not the sensor that
        is wrong; or it is, and the filter has no business without it. The compass alone is not reason enough, gyros are
        better. Nor is a profiler a quarter noisier than its file says: that is the sensor's flag.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtr, chdtri

from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.error_state_filter import Innovations
from ltv_mpc.localisation.out_of_sequence import REACH_NS
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import SENSORS, fitted
from ltv_mpc.localisation.sensors.sensor import Availability
from ltv_mpc.localisation.sensors.settings import latency_ns
from ltv_mpc.messages import Array, FilterStatus, SensorReport, SensorStatus

WINDOW_NS = 10_000_000_000
SILENT_PERIODS = 3
MIN_MESSAGES = 3
"""Messages below which a mean is not judged."""
FALSE_ALARM = 1e-6
GROSS_NIS = 2.3
"""Upper end of the band of thirty messages, a window of pings, were all rows of a message one."""
ONLY_TOO_LARGE = frozenset(s.name for s in SENSORS if s.availability is not Availability.CONTINUOUS)
ESSENTIAL = frozenset(s.name for s in SENSORS if s.is_essential)
NOT_REJECTED = ("used", "deweighted", "late_applied")
"""The first counts what the others do."""
AT_SURFACE = frozenset(s.name for s in SENSORS if s.availability is Availability.SURFACE)
"""Silent by design once the descent has begun."""


class _Judged(NamedTuple):
    t_ns: int
    rows: int
    passed: int
    squares: float  # sum of x over those that passed
    pairs: float  # sum of rho_ij^2 over them


class HealthMonitor:
    """Hears every verdict once; asked once a second."""

    def __init__(self, suite: SensorConfig, gate_probability: float) -> None:
        """Sensors that ``suite`` does not have are not reported."""
        gate = float(chdtri(1, 1.0 - gate_probability))
        self._expected = float(chdtr(3, gate) / chdtr(1, gate))
        self._silent_ns = _silent_after(suite)
        self._window: dict[str, deque[_Judged]] = {name: deque() for name in self._silent_ns}
        self._last_ns: dict[str, int] = {}
        self._reported: Mapping[str, int] = {}
        self.broken = False  # a covariance of innovations was not positive definite: the filter's own is not either

    def observe(self, verdict: Innovations) -> None:
        """What came of one message."""
        window = self._window.get(verdict.sensor)
        if window is None:
            return
        self.broken = self.broken or not verdict.definite
        passed, squares, pairs = _judged(verdict.residual, verdict.S, verdict.accepted)
        window.append(_Judged(verdict.t_ns, len(verdict.residual), passed, squares, pairs))
        self._last_ns[verdict.sensor] = max(verdict.t_ns, self._last_ns.get(verdict.sensor, verdict.t_ns))

    def reset(self) -> None:
        """The filter has begun anew: what the old one said of the sensors does not count."""
        self.broken = False
        for window in self._window.values():
            window.clear()

    def sensors(self, t_ns: int, account: Mapping[str, int]) -> tuple[SensorReport, ...]:
        """One report a sensor at ``t_ns``; ``account`` counts from the beginning (``Estimator.account``)."""
        new: dict[str, dict[str, int]] = {name: {} for name in self._window}
        for key, count in account.items():
            name, _, what = key.partition(".")
            more = count - self._reported.get(key, 0)
            if name in new and more > 0:
                new[name][what] = more
        self._reported = dict(account)
        reports = []
        for name, window in self._window.items():
            while window and window[0].t_ns <= t_ns - WINDOW_NS:
                window.popleft()
            counts = new[name]
            refused = {what: counts[what] for what in sorted(counts) if what not in NOT_REJECTED}
            nis, status = self._judge(name, t_ns)
            reports.append(
                SensorReport(
                    sensor=name,
                    status=status,
                    used=counts.get("used", 0),
                    rejected=refused,
                    nis=nis,
                    last_t_ns=self._last_ns.get(name),
                )
            )
        return tuple(reports)

    def _judge(self, name: str, t_ns: int) -> tuple[float | None, SensorStatus]:
        window = self._window[name]
        rows = passed = 0
        squares = pairs = 0.0
        for _, of_one, through, their_squares, their_pairs in window:
            rows, passed, squares, pairs = rows + of_one, passed + through, squares + their_squares, pairs + their_pairs
        nis = squares / passed / self._expected if passed else None
        last_ns = self._last_ns.get(name)
        if last_ns is None or t_ns - last_ns > self._silent_ns[name]:
            ended = name in AT_SURFACE and t_ns > 0
            return nis, SensorStatus.OK if ended else SensorStatus.SILENT
        if len(window) >= 2 and 2 * passed < rows:
            return nis, SensorStatus.REJECTED
        if nis is not None and len(window) >= MIN_MESSAGES:
            low, high = band(passed * passed / pairs)
            if nis > high or (nis < low and name not in ONLY_TOO_LARGE):
                return nis, SensorStatus.INCONSISTENT
        return nis, SensorStatus.OK


@jit
def _judged(residual: Array, S: Array, accepted: npt.NDArray[np.bool_]) -> tuple[int, float, float]:
    """Of a message's rows: how many passed, the sum of their x, and of rho_ij^2 over all their pairs."""
    weight = np.zeros(len(residual))
    for i in range(len(residual)):
        if accepted[i]:
            weight[i] = 1.0 / S[i, i]
    passed, squares, pairs, of_each = 0, 0.0, 0.0, np.zeros(len(residual))
    for i in range(len(residual)):
        if accepted[i]:
            passed += 1
            squares += residual[i] * residual[i] * weight[i]
            row = S[i]
            for j in range(len(residual)):
                of_each[j] += row[j] * row[j] * weight[i] * weight[j]
    for j in range(len(residual)):
        if accepted[j]:
            pairs += of_each[j]
    return passed, squares, pairs


def band(independent: float) -> tuple[float, float]:
    """Of a mean over this many independent squares."""
    low, high = chdtri(independent, 1.0 - FALSE_ALARM), chdtri(independent, FALSE_ALARM)
    return float(low) / independent, float(high) / independent


def filter_status(reports: tuple[SensorReport, ...]) -> tuple[FilterStatus, str]:
    """The filter's status by its sensors', and why in words."""
    wrong = [r for r in reports if _is_gross(r)]
    if any(r.sensor in ESSENTIAL for r in wrong) or len(wrong) > 1:
        return FilterStatus.INCONSISTENT, "; ".join(_words(r) for r in wrong)
    return FilterStatus.NOMINAL, ""


def _is_gross(report: SensorReport) -> bool:
    if report.status is SensorStatus.INCONSISTENT:
        return report.nis is not None and report.nis > GROSS_NIS
    return report.status is SensorStatus.REJECTED


def _words(report: SensorReport) -> str:
    if report.status is SensorStatus.REJECTED:
        return f"{report.sensor}: most of it fails the gate"
    return f"{report.sensor}: squared innovations {report.nis:.2g} times what is said"


def _silent_after(suite: SensorConfig) -> dict[str, int]:
    """Return the maximum age (ns) of the newest message of each sensor that corrects the filter, by name."""
    after = {}
    for sensor, settings in fitted(suite):
        latency = latency_ns(settings)
        after[sensor.name] = SILENT_PERIODS * settings.period_ns + (REACH_NS if latency is None else latency)
    return after
