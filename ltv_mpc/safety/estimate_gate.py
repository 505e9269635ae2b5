"""Estimate gate: reject estimates that the vehicle cannot have reached, before the controller uses them.

An estimate is accepted if

    position, heading, velocities, yaw rate, depth, sinking speed, covariance and current are finite
    the depths of the current increase, and each has its velocities
    |velocity over ground|  <=  2 x top speed through the water + 3 m/s of current
    |yaw rate|              <=  3 x the steady rate at full opposite thrusts + 0.5 rad/s
    |sinking speed|         <=  2 x the steady rate at full thrust and net buoyancy + 1 m/s

and if it is reachable from the last accepted one, a time dt before. With s the sum of the standard deviations of both
estimates, from their covariances (5 m and 0.5 rad for an estimate without covariance):

    |p - (p0 + v0 dt)|      <=  speed bound x dt + 1 m, or 5 s
    |psi - (psi0 + r0 dt)|  <=  yaw rate bound x dt + 0.5 rad, or 5 s
    |z - z0|                <=  sinking bound x dt + 2 m

A correct filter can also jump, after a fix that ends a long drift. Therefore a jump is rejected only once: the second
of two successive estimates that are consistent with each other is accepted. While estimates are rejected, the last
accepted one stays in use and ages, so a source of implausible estimates has the same effect as a silent one.

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
from collections import Counter, deque
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.messages import CurrentProfile, Estimate, Health, Pair
from ltv_mpc.safety.health import DEFAULT_AGES, NOMINAL, PREDICTED_TOO_FAR, Ages, HealthState, health
from ltv_mpc.safety.input_age import InputAge
from ltv_mpc.validation import relation_reason
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.resistance import steady_speed

CURRENT_MPS = 3.0
JUMP_M, JUMP_RAD, JUMP_DEPTH_M = 1.0, 0.5, 2.0
SIGMAS = 5.0
UNKNOWN_SD_M, UNKNOWN_SD_RAD = 5.0, 0.5
"""Standard deviations of an estimate without covariance: those of a plain satellite fix."""

NOT_FINITE = "a number is not finite"
REJECTED = "the newest was rejected: "
JUMPED = "jumped farther than the vehicle can move"

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


class Bounds(NamedTuple):
    """Bounds of a vehicle's motion."""

    speed_mps: float  # over ground
    yaw_rate_radps: float
    sinking_mps: float

    @classmethod
    def of(cls, vehicle: Vehicle) -> Bounds:
        """Return the steady speeds at full thrust against the damping, widened as in the module docstring.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        """
        surge, yaw, sinking = max(vehicle.pushes_N), max(vehicle.couples_Nm), 0.0
        if vehicle.heave is not None:
            vertical = vehicle.thrusters[2]
            heave = max(vertical.max_N, -vertical.min_N) + abs(vehicle.net_buoyancy_N)
            sinking = steady_speed(heave, vehicle.heave.linear_damping_kgps, vehicle.heave.quadratic_damping_kgpm)
        top = steady_speed(surge, vehicle.surge.linear_damping_kgps, vehicle.surge.quadratic_damping_kgpm)
        turning = steady_speed(yaw, vehicle.yaw.linear_damping_Nms, vehicle.yaw.quadratic_damping_kgm2)
        return cls(2.0 * top + CURRENT_MPS, 3.0 * turning + 0.5, 2.0 * sinking + 1.0)


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


class EstimateGate:
    """Filter for incoming estimates that keeps the newest accepted one, and the health that follows from its age."""

    def __init__(self, vehicle: Vehicle, ages: Ages = DEFAULT_AGES) -> None:
        """Begin without an estimate.

        Parameters
        ----------
        vehicle : bounds of its motion decide what is plausible.
        ages : at which the health degrades.
        """
        self.rejected: Counter[str] = Counter()
        """Number of rejected estimates, by reason."""
        self.accepted: Estimate | None = None
        """Newest accepted estimate."""
        self.age = InputAge()
        """Age of the accepted estimates, by their stamps."""
        self.growth_m = 0.0
        """Growth of the standard deviation of the predicted position since the estimate, if that is late (m)."""
        self._bounds, self._ages = Bounds.of(vehicle), ages
        self._positions = PositionFilter()
        self._uncertain: Estimate | None = None  # the last one from which the prediction grew too uncertain
        self._jumped: Estimate | None = None  # the last estimate, if it was rejected as a jump
        self._last: tuple[Estimate | None, str] = (None, "")  # the last rejected estimate, and the reason

    def check(self, estimate: Estimate) -> str:
        """Return the reason why ``estimate`` is rejected; empty if it is accepted now or was before.

        Parameters
        ----------
        estimate : newest estimate.
        """
        if estimate is self.accepted:
            return ""
        last, reason = self._last
        if estimate is last:
            return reason
        reason = self.out_of_bounds(estimate)
        if reason:
            self._jumped = None
        elif self.accepted is not None and self.jumps(self.accepted, estimate):
            before, self._jumped = self._jumped, estimate
            if before is None or before.t_ns == estimate.t_ns or self.jumps(before, estimate):
                reason = JUMPED
        if reason:
            self.rejected[reason] += 1
            self._last = estimate, reason
            return reason
        self.age.add(estimate.t_ns)
        self.accepted, self._jumped, self._last = estimate, None, (None, "")
        return ""

    def restart(self) -> None:
        """Begin with another source: its next plausible estimate is accepted, and its period is its own."""
        self.accepted = self._jumped = None
        self.age, self._last, self._positions = InputAge(), (None, ""), PositionFilter()

    def select(self, newest: Estimate) -> Estimate | None:
        """Return the newest accepted estimate, with its position filtered if it is noisy; None before the first.

        Parameters
        ----------
        newest : estimate that was received last.
        """
        self.check(newest)
        self.growth_m = 0.0
        return None if self.accepted is None else self._positions.update(self.accepted)

    def health(self, t_ns: int) -> HealthState:
        """Return the health by the age of the newest accepted estimate, and by ``limit_growth``.

        Parameters
        ----------
        t_ns : now, vehicle time (ns).
        """
        _, reason = self._last
        if self.accepted is None:
            return (
                HealthState(Health.FAILSAFE, f"no valid estimate: {reason}")
                if reason
                else health(age_ns=None, period_ns=0)
            )
        state = health(age_ns=t_ns - self.accepted.t_ns, period_ns=self.age.median_ns, ages=self._ages)
        if self.accepted is self._uncertain and state.health is Health.DEGRADED:
            state = HealthState(Health.HOLD, PREDICTED_TOO_FAR)
        return state if not reason or state is NOMINAL else state._replace(why=f"{state.why}; {REJECTED}{reason}")

    def limit_growth(self, growth_m: float) -> None:
        """Hold until the next accepted estimate if the prediction from the newest one is too uncertain.

        Parameters
        ----------
        growth_m : growth of the standard deviation of the predicted position (m); NaN is too uncertain.
        """
        self.growth_m = growth_m if growth_m > 0.0 else 0.0  # not a number: the vehicle holds
        if not growth_m <= self._ages.hold_growth_m:
            self._uncertain = self.accepted

    def out_of_bounds(self, e: Estimate) -> str:
        """Return which bound an estimate exceeds by itself; NaN exceeds every bound.

        Parameters
        ----------
        e : any estimate.
        """
        bounds = self._bounds
        vn, ve = e.velocity_north_mps, e.velocity_east_mps
        if not math.isfinite(e.north_m + e.east_m + e.heading_rad + vn + ve + e.yaw_rate_radps):
            return NOT_FINITE
        if not vn * vn + ve * ve <= bounds.speed_mps * bounds.speed_mps:
            return "velocity over ground above what the vehicle can reach"
        if not abs(e.yaw_rate_radps) <= bounds.yaw_rate_radps:
            return "yaw rate above what the vehicle can reach"
        P = e.covariance
        if not math.isfinite(e.depth_m or 0.0) or not (P is None or math.isfinite(np.vdot(P, P))):
            return NOT_FINITE
        if not abs(e.velocity_down_mps or 0.0) <= bounds.sinking_mps:
            return "sinking speed above what the vehicle can reach"
        return "" if e.current is None else _problem(e.current)

    def jumps(self, old: Estimate, new: Estimate) -> bool:
        """Return True if the vehicle cannot have moved from ``old`` to ``new`` in the time between them.

        Parameters
        ----------
        old, new : two estimates.
        """
        bounds = self._bounds
        dt = abs(new.t_ns - old.t_ns) * 1e-9
        off_n = new.north_m - old.north_m - old.velocity_north_mps * dt
        off_e = new.east_m - old.east_m - old.velocity_east_mps * dt
        reach = bounds.speed_mps * dt + JUMP_M
        if off_n * off_n + off_e * off_e > reach * reach:
            sd = sum(standard_deviation(e, (0, 1), UNKNOWN_SD_M) for e in (old, new))
            if math.hypot(off_n, off_e) > max(reach, SIGMAS * sd):
                return True
        turned = abs(math.remainder(new.heading_rad - old.heading_rad - old.yaw_rate_radps * dt, math.tau))
        reach = bounds.yaw_rate_radps * dt + JUMP_RAD
        if turned > reach and turned > SIGMAS * sum(standard_deviation(e, (4,), UNKNOWN_SD_RAD) for e in (old, new)):
            return True
        if old.depth_m is None or new.depth_m is None:
            return False
        return abs(new.depth_m - old.depth_m) > bounds.sinking_mps * dt + JUMP_DEPTH_M


def _problem(profile: CurrentProfile) -> str:
    """Return what makes a profile of the current useless; empty if nothing does."""
    reason = relation_reason(profile)
    if reason is not None:
        return f"current: {reason}"
    north, east = profile.north_mps, profile.east_mps
    return "" if math.isfinite(np.vdot(north, north) + np.vdot(east, east)) else NOT_FINITE


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
