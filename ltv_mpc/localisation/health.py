"""Health of the filter and of each sensor, from the innovations before the gate.

Window        the last 10 s of each sensor: its rows, how many of them passed, and of those  x = r_i^2 / S_ii
NIS           the mean x of the rows that passed, over its expectation for chi-square truncated at the gate g,
                  E[x | x <= g] = F_3(g) / F_1(g),   F_k the distribution of chi-square of k degrees of freedom
              Outliers count as rejected and not in the NIS, so that a few of them do not make a good sensor suspect.
Limits        of a sensor's NIS: chi-square of N degrees of freedom over N, at 1e-6 on either side. The rows of one
              message share the vehicle's error. The sum of their x has the variance 2 sum rho_ij^2, rho their
              correlation in S, so that m rows count as  N = m^2 / sum_ij rho_ij^2  independent ones. The 56 rows of a
              profiler's message count as about 50, its window as about 1500. Messages of a consistent filter are
              independent. These limits give one false alarm a week.
              Sensors that are not continuous have the upper limit alone (``sensors/sensor.py``).
Rejected      A sensor is rejected if more than half of the rows in the window, of two messages or more, fail the gate.
Inconsistent  The filter is inconsistent if an essential sensor (profiler, bottom track, pressure) is rejected, or its
              NIS is above ``GROSS_NIS``, or if one of both holds for two sensors of any kind. Then either the filter is
              wrong or a sensor that it needs. The compass alone is not sufficient, because the gyros are better. A
              profiler that is a quarter noisier than its file states has an inconsistent status, the filter has not.
Samples       The NIS shows whether innovations have the size that the filter expects. Their values also show a bias,
              and which sensor noise is wrong in metres, m/s or radians: the report has a few of the newest message.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtr, chdtri

from ltv_mpc.localisation.filter.error_state_filter import Innovations
from ltv_mpc.localisation.out_of_sequence import REACH_NS
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import SENSORS, fitted
from ltv_mpc.localisation.sensors.sensor import Availability
from ltv_mpc.localisation.sensors.settings import latency_ns
from ltv_mpc.messages import Array, FilterStatus, InnovationSample, SensorReport, SensorStatus

WINDOW_NS = 10_000_000_000
"""Length of the window."""
SILENT_PERIODS = 3
"""Periods without a message, beside the latency, after which a sensor is silent."""
MIN_MESSAGES = 3
"""Minimum number of messages for which a mean is tested."""
FALSE_ALARM = 1e-6
"""Probability on either side of the limits of the NIS."""
GROSS_NIS = 2.3
"""Upper limit of the NIS of thirty messages, a window of pings, if the rows of each counted as one."""
ONLY_TOO_LARGE = frozenset(s.name for s in SENSORS if s.availability is not Availability.CONTINUOUS)
ESSENTIAL = frozenset(s.name for s in SENSORS if s.is_essential)
NOT_REJECTED = ("used", "deweighted", "late_applied")
"""Outcomes of measurements that corrected the filter; the count of "used" includes the two others."""
AT_SURFACE = frozenset(s.name for s in SENSORS if s.availability is Availability.SURFACE)
"""Sensors whose silence is normal during the descent."""
MAX_ROWS = 4
"""Maximum number of innovations of one message: of a profiler about one a beam. It has 56 of them, and most say the
same, because they share the error of the vehicle."""


class _Record(NamedTuple):
    """Innovations of one message."""

    t_ns: int
    rows: int
    passed: int
    squares: float  # sum of x over those that passed
    pairs: float  # sum of rho_ij^2 over them


class HealthMonitor:
    """Monitor of the innovations, evaluated once a second."""

    def __init__(self, sensor_config: SensorConfig, gate_probability: float) -> None:
        """Create a monitor of the sensors that the vehicle has.

        Parameters
        ----------
        sensor_config : settings of the sensors.
        gate_probability : probability with which a correct row passes the filter's gate.
        """
        gate = float(chdtri(1, 1.0 - gate_probability))
        self._expected = float(chdtr(3, gate) / chdtr(1, gate))
        self._silent_ns = _silent_after(sensor_config)
        self._window: dict[str, deque[_Record]] = {name: deque() for name in self._silent_ns}
        self._last_ns: dict[str, int] = {}
        self._reported: Mapping[str, int] = {}
        self.broken = False
        """True if a covariance of innovations was not positive definite, so that of the filter is not either."""

    def observe(self, innovations: Innovations) -> None:
        """Record the innovations of one message.

        Parameters
        ----------
        innovations : of one message, before the gate.
        """
        window = self._window.get(innovations.sensor)
        if window is None:
            return
        self.broken = self.broken or not innovations.definite
        passed, squares, pairs = innovation_statistics(innovations.residual, innovations.S, innovations.accepted)
        window.append(_Record(innovations.t_ns, len(innovations.residual), passed, squares, pairs))
        t_ns = innovations.t_ns
        self._last_ns[innovations.sensor] = max(t_ns, self._last_ns.get(innovations.sensor, t_ns))

    def reset(self) -> None:
        """Forget all innovations, because they belong to a filter that has been replaced."""
        self.broken = False
        for window in self._window.values():
            window.clear()

    def sensors(self, t_ns: int, account: Mapping[str, int]) -> tuple[SensorReport, ...]:
        """Return one report for each sensor.

        Parameters
        ----------
        t_ns : time of the report (ns).
        account : counts by "<sensor>.<outcome>" since the start (``Estimator.account``).
        """
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
            rejected = {what: counts[what] for what in sorted(counts) if what not in NOT_REJECTED}
            nis, status = self._judge(name, t_ns)
            reports.append(
                SensorReport(
                    sensor=name,
                    status=status,
                    used=counts.get("used", 0),
                    rejected=rejected,
                    nis=nis,
                    last_t_ns=self._last_ns.get(name),
                )
            )
        return tuple(reports)

    def _judge(self, name: str, t_ns: int) -> tuple[float | None, SensorStatus]:
        window = self._window[name]
        rows, passed = sum(record.rows for record in window), sum(record.passed for record in window)
        squares, pairs = sum(record.squares for record in window), sum(record.pairs for record in window)
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


class InnovationSamples:
    """Store of the newest innovations of each sensor since the last report."""

    def __init__(self) -> None:
        self._newest: dict[tuple[str, int], InnovationSample] = {}

    def observe(self, innovations: Innovations) -> None:
        """Store those innovations of one message that passed the gate, at most ``MAX_ROWS`` at equal steps.

        Parameters
        ----------
        innovations : of one message, before the gate.
        """
        accepted = np.flatnonzero(innovations.accepted)
        if not len(accepted):
            return
        shown = accepted[:: -(-len(accepted) // MAX_ROWS)]
        # A message with a single row may come from one of several transponders, which its index names.
        source = int(innovations.indices[0]) if len(innovations.residual) == 1 else 0
        self._newest[innovations.sensor, source] = InnovationSample(
            sensor=innovations.sensor,
            t_ns=innovations.t_ns,
            rows=tuple(innovations.indices[shown].tolist()),
            innovations=tuple(innovations.residual[shown].tolist()),
            sd=tuple(np.sqrt(innovations.S[shown, shown]).tolist()),
        )

    def take(self) -> tuple[InnovationSample, ...]:
        """Return what was stored since the last call, in order of the first message of each sensor."""
        samples = tuple(self._newest.values())
        self._newest.clear()
        return samples


def innovation_statistics(residual: Array, S: Array, accepted: npt.NDArray[np.bool_]) -> tuple[int, float, float]:
    """Return how many rows of a message passed, the sum of their x, and the sum of rho_ij^2 over their pairs.

    Parameters
    ----------
    residual : (m,) innovations.
    S : (m, m) their covariance.
    accepted : (m,) which of them passed the gate.
    """
    r, passed = residual[accepted], S[accepted][:, accepted]
    variance = passed.diagonal()
    return len(r), float((r * r / variance).sum()), float(((passed * passed) @ (1.0 / variance) / variance).sum())


def band(independent: float) -> tuple[float, float]:
    """Return the lower and upper limit of the NIS for a mean over this many independent squares."""
    low, high = chdtri(independent, 1.0 - FALSE_ALARM), chdtri(independent, FALSE_ALARM)
    return float(low) / independent, float(high) / independent


def filter_status(reports: tuple[SensorReport, ...]) -> tuple[FilterStatus, str]:
    """Return the status of the filter and the reason, from the reports of its sensors."""
    wrong = [r for r in reports if _is_gross(r)]
    if any(r.sensor in ESSENTIAL for r in wrong) or len(wrong) > 1:
        return FilterStatus.INCONSISTENT, "; ".join(_reason(r) for r in wrong)
    return FilterStatus.NOMINAL, ""


def _is_gross(report: SensorReport) -> bool:
    if report.status is SensorStatus.INCONSISTENT:
        return report.nis is not None and report.nis > GROSS_NIS
    return report.status is SensorStatus.REJECTED


def _reason(report: SensorReport) -> str:
    if report.status is SensorStatus.REJECTED:
        return f"{report.sensor}: more than half of its measurements fail the gate"
    return f"{report.sensor}: mean squared innovation {report.nis:.2g} times the expected value"


def _silent_after(sensor_config: SensorConfig) -> dict[str, int]:
    """Return the maximum age (ns) of the newest message of each sensor that corrects the filter, by name."""
    after = {}
    for sensor, settings in fitted(sensor_config):
        latency = latency_ns(settings)
        after[sensor.name] = SILENT_PERIODS * settings.period_ns + (REACH_NS if latency is None else latency)
    return after
