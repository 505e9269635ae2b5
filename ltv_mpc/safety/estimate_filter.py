"""Estimate filter: what of an accepted estimate the controller uses.

Velocities and yaw rate that contradict positions and headings are replaced by those of ``rate_check.py``.

A navigation filter gives a position that is the integral of its velocity, up to small corrections. A bare receiver
gives positions with white noise, and the controller would follow the noise. So without a covariance the position is
filtered. With positions p and velocities v, for each horizontal component,

    R = (1.48 median |p - p_before - v dt|)^2 / 2     over the last ``WINDOW`` estimates: variance of a position
    x <- x + v dt,   P <- P + q^2 dt
    K = P / (P + R),   x <- x + K (p - x),   P <- (1 - K) P

A single correction of the position, a fix after a drift, does not change the median. Up to a noise of ``CLEAN_M`` the
estimates are used as they are.
"""

from __future__ import annotations

import math
from collections import deque

import msgspec
import numpy as np

from ltv_mpc.messages import Estimate, Health, Pair
from ltv_mpc.references.limits import path_limits
from ltv_mpc.safety.health import NOMINAL, HealthState
from ltv_mpc.safety.rate_check import RateCheck
from ltv_mpc.vehicle.parameters import Vehicle

WINDOW = 15
"""Number of innovations in the median: a noise shows after 8 estimates."""

CLEAN_M = 0.03
"""Noise of the positions up to which they are used as they are."""

VELOCITY_ERROR_M_PER_RTS = 0.02
"""q: random walk of the integral of the velocities."""

MAX_INTERVAL_NS = 2_000_000_000
"""Longest time between two estimates: over a longer one the velocity is not constant enough, and the filter starts."""

OF_MEDIAN = 1.4826
"""Standard deviation over the median of the absolute value, of a normal distribution."""


class PositionFilter:
    """Kalman filter of the horizontal position, with the noise that the positions show."""

    def __init__(self) -> None:
        self._last: Estimate | None = None  # as it was given
        self._filtered: Pair | None = None  # None: as it was given
        self._variance = 0.0
        self._innovations: deque[float] = deque(maxlen=2 * WINDOW)  # both components of each

    def update(self, estimate: Estimate) -> Estimate:
        """Return the estimate with the filtered position; itself if its positions are clean, or have a covariance.

        Parameters
        ----------
        estimate : the newest accepted one.
        """
        last, self._last = self._last, estimate
        if last is not None and estimate.t_ns == last.t_ns:
            return self._with_position(estimate)
        if last is None or not 0 < estimate.t_ns - last.t_ns <= MAX_INTERVAL_NS or estimate.covariance is not None:
            self._filtered, self._variance = None, 0.0
            self._innovations.clear()
            return estimate
        seconds = (estimate.t_ns - last.t_ns) * 1e-9
        north_m = 0.5 * seconds * (last.velocity_north_mps + estimate.velocity_north_mps)
        east_m = 0.5 * seconds * (last.velocity_east_mps + estimate.velocity_east_mps)
        self._innovations.append(abs(estimate.north_m - last.north_m - north_m))
        self._innovations.append(abs(estimate.east_m - last.east_m - east_m))
        # the difference of two positions has twice the variance of one
        middle = sorted(self._innovations)[len(self._innovations) // 2]  # numpy's median takes ten times as long
        noise_m = OF_MEDIAN * math.sqrt(0.5) * middle
        if len(self._innovations) < WINDOW or noise_m <= CLEAN_M:
            self._filtered, self._variance = None, noise_m**2
            return estimate
        self._variance += VELOCITY_ERROR_M_PER_RTS**2 * seconds
        gain = self._variance / (self._variance + noise_m**2)
        before = self._filtered or (last.north_m, last.east_m)
        north_m, east_m = before[0] + north_m, before[1] + east_m  # predicted
        self._filtered = north_m + gain * (estimate.north_m - north_m), east_m + gain * (estimate.east_m - east_m)
        self._variance *= 1.0 - gain
        return self._with_position(estimate)

    def _with_position(self, estimate: Estimate) -> Estimate:
        if self._filtered is None:
            return estimate
        return msgspec.structs.replace(estimate, north_m=self._filtered[0], east_m=self._filtered[1])


class EstimateFilter:
    """Filter of the estimates of one source."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Begin without an estimate.

        Parameters
        ----------
        vehicle : its largest rates and accelerations are the scales of the check.
        """
        limits, thrusters = path_limits(vehicle), vehicle.thrusters[:2]
        turning_radps2 = sum(t.max_N * t.arm_m for t in thrusters) / vehicle.yaw.inertia_kgm2
        self.velocity = RateCheck(limits.top_mps, sum(t.max_N for t in thrusters) / vehicle.surge.mass_kg)
        """Check of the velocity over ground against the position."""
        self.yaw_rate = RateCheck(limits.yaw_radps, turning_radps2)
        """Check of the yaw rate against the heading."""
        self._heading_rad = 0.0  # unwrapped
        self._positions = PositionFilter()

    @property
    def health(self) -> HealthState:
        """Degraded while a rate is derived."""
        rates = [(self.velocity, "velocities", "positions"), (self.yaw_rate, "yaw rates", "headings")]
        failed = [f"the {rate} of the estimates are not those of the {of}" for check, rate, of in rates if check.failed]
        return HealthState(Health.DEGRADED, "; ".join(failed)) if failed else NOMINAL

    def with_rates(self, estimate: Estimate) -> Estimate:
        """Return an estimate with derived rates; itself while none fails.

        Parameters
        ----------
        estimate : the newest one.
        """
        e, used = estimate, estimate
        place, over_ground = np.array([e.north_m, e.east_m]), np.array([e.velocity_north_mps, e.velocity_east_mps])
        sd = standard_deviation(e, (0, 1), 0.0), standard_deviation(e, (2, 3), 0.0)
        derived = self.velocity.update(e.t_ns, place, over_ground, sd)
        if derived is not None:
            names = ("north_m", "east_m", "velocity_north_mps", "velocity_east_mps")
            changes = dict(zip(names, np.concatenate(derived).tolist(), strict=True))
            used = msgspec.structs.replace(used, **changes)
        self._heading_rad += math.remainder(e.heading_rad - self._heading_rad, math.tau)
        sd = standard_deviation(e, (4,), 0.0), standard_deviation(e, (5,), 0.0)
        derived = self.yaw_rate.update(e.t_ns, np.array([self._heading_rad]), np.array([e.yaw_rate_radps]), sd)
        return used if derived is None else msgspec.structs.replace(used, yaw_rate_radps=float(derived[1][0]))

    def with_position(self, estimate: Estimate) -> Estimate:
        """Return an estimate with the filtered position; itself if it is clean, or has a covariance.

        Parameters
        ----------
        estimate : the newest accepted one, with its rates.
        """
        return self._positions.update(estimate)


def standard_deviation(estimate: Estimate, indices: tuple[int, ...], unknown: float) -> float:
    """Return the standard deviation of some states, from the diagonal of the covariance.

    Parameters
    ----------
    estimate : any estimate.
    indices : places of the states in the covariance.
    unknown : result for an estimate without covariance.
    """
    P = estimate.covariance
    return unknown if P is None else math.sqrt(sum(max(float(P[i, i]), 0.0) for i in indices))
