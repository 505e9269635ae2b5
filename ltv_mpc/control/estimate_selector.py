"""Selection of the newest plausible estimate, with a filter of its position, and the checks of its motion.

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

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.messages import Estimate, Health, Pair
from ltv_mpc.safety.actuator_check import ActuatorCheck
from ltv_mpc.safety.estimate_gate import EstimateGate
from ltv_mpc.safety.health import PREDICTED_TOO_FAR, HealthState, health
from ltv_mpc.safety.motion_fit import MotionFit
from ltv_mpc.safety.vehicle_file_check import VehicleFileCheck
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


class EstimateSelector:
    """Selection of the newest plausible estimate, and the health that follows from its age."""

    def __init__(self, vehicle: Vehicle, config: ControllerConfig) -> None:
        """Start without an estimate.

        Parameters
        ----------
        vehicle : bounds of its motion decide what is plausible.
        config : the ages at which health degrades are used.
        """
        self.gate = EstimateGate(vehicle)
        """Plausibility check, with the count of rejected estimates."""
        self.vehicle_file_check = VehicleFileCheck()
        """Check of the vehicle file against what the motion shows."""
        self.motion_fit = MotionFit(vehicle)
        """Vehicle, sea and stamps that explain the motion."""
        self.actuator_check = ActuatorCheck(vehicle, config.period_ns)
        """Check of the actuators' reports: whether the motion of the estimates comes from the plans."""
        self._vehicle, self._positions, self._ages = vehicle, PositionFilter(), config.ages
        self._without = health(age_ns=None, period_ns=0)  # health before the first plausible estimate
        self._uncertain: Estimate | None = None  # the last one from which the prediction grew too uncertain
        self.growth_m = 0.0
        """Growth of the standard deviation of the predicted position since the estimate, if that is late (m)."""

    def select(self, newest: Estimate) -> Estimate | None:
        """Return the newest plausible estimate, with its position filtered if it is noisy; None before the first.

        Parameters
        ----------
        newest : estimate that was received last.
        """
        reason = self.gate.check(newest)
        estimate, self.growth_m = self.gate.accepted, 0.0
        if estimate is None:
            self._without = HealthState(Health.FAILSAFE, f"no valid estimate: {reason}")
            return None
        return self._positions.update(estimate)

    def restart(self) -> None:
        """Begin with another source of estimates."""
        self.gate.restart()
        self._positions = PositionFilter()
        self.vehicle_file_check, self.motion_fit = VehicleFileCheck(), MotionFit(self._vehicle)

    def health(self, t_ns: int) -> HealthState:
        """Return the health by the age of the newest plausible estimate, and by ``limit_growth``.

        Parameters
        ----------
        t_ns : now, vehicle time (ns).
        """
        estimate = self.gate.accepted
        if estimate is None:
            return self._without
        age_ns = t_ns - estimate.t_ns
        state = health(age_ns=age_ns, period_ns=self.gate.age.median_ns, ages=self._ages)
        if estimate is self._uncertain and state.health is Health.DEGRADED:
            return HealthState(Health.HOLD, PREDICTED_TOO_FAR)
        return state

    def limit_growth(self, growth_m: float) -> None:
        """Hold until the next plausible estimate if the prediction from the newest one is too uncertain.

        Parameters
        ----------
        growth_m : growth of the standard deviation of the predicted position (m); NaN is too uncertain.
        """
        self.growth_m = growth_m if growth_m > 0.0 else 0.0  # not a number: the vehicle holds
        if not growth_m <= self._ages.hold_growth_m:
            self._uncertain = self.gate.accepted
