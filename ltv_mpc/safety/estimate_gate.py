"""Estimate gate: reject estimates that the vehicle cannot have reached, before the controller uses them.

An estimate is accepted if

    position, heading, velocities, yaw rate, depth, sinking speed, covariance and current are finite
    the depths of the current increase, and each has its velocities
    |velocity over ground|  <=  2 x top speed through the water + 3 m/s of current
    |yaw rate|              <=  3 x the steady rate at full opposite thrusts + 0.5 rad/s
    |sinking speed|         <=  2 x the steady rate at full thrust and net buoyancy + 1 m/s

and is not an earlier one with another stamp: its velocity or yaw rate would have changed position or heading by more
than ``REPEATED_WAY``, or for longer than ``STANDS_S``. It must be reachable from the last accepted one, a time dt
before. With s the sum of the standard deviations of both estimates, from their covariances (5 m and 0.5 rad for an
estimate without covariance):

    |p - (p0 + v0 dt)|      <=  speed bound x dt + 1 m, or 5 s
    |psi - (psi0 + r0 dt)|  <=  yaw rate bound x dt + 0.5 rad, or 5 s
    |z - z0|                <=  sinking bound x dt + 2 m

A correct filter can also jump, after a fix that ends a long drift. Therefore a jump is rejected only once: the second
of two successive estimates that are consistent with each other is accepted. While estimates are rejected, the last
accepted one stays in use and ages, so a source of implausible estimates has the same effect as a silent one.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.conversion import exact
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import CurrentProfile, Estimate, Health
from ltv_mpc.safety.estimate_filter import EstimateFilter, standard_deviation
from ltv_mpc.safety.health import DEFAULT_AGES, NOMINAL, PREDICTED_TOO_FAR, Ages, HealthState, health
from ltv_mpc.safety.input_age import InputAge
from ltv_mpc.safety.kinematic_filter import STANDS_S
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
REPEATED = "an earlier one with another stamp"
REPEATED_WAY, AT_REST = 0.05, 1e-4
"""Way (m) or angle (rad) that the rates of an estimate give until it cannot be true any more; and rate (m/s, or rad/s)
from which ``STANDS_S`` is enough.
"""

TOO_FAST, TURNS_TOO_FAST = (f"{rate} above what the vehicle can reach" for rate in ("velocity over ground", "yaw rate"))


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
        self._new_ns = 0  # time of the first estimate with the motion of the accepted one
        self._vehicle, self._bounds, self._ages = vehicle, Bounds.of(vehicle), ages
        self.filter = EstimateFilter(vehicle)
        """What of the accepted estimates is used."""
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
        if reason or (reason := self._repeats(estimate)):
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
        if self.accepted is None or _motion(estimate) != _motion(self.accepted):
            self._new_ns = estimate.t_ns
        self.accepted, self._jumped, self._last = estimate, None, (None, "")
        return ""

    def _repeats(self, estimate: Estimate) -> str:
        """Return the reason why an estimate is an old one with another stamp; empty if it is not."""
        if self.accepted is None or _motion(estimate) != _motion(self.accepted):
            return ""
        speed_mps = math.hypot(estimate.velocity_north_mps, estimate.velocity_east_mps)
        rate, seconds = max(speed_mps, abs(estimate.yaw_rate_radps)), (estimate.t_ns - self._new_ns) * 1e-9
        return REPEATED if rate * seconds > REPEATED_WAY or (rate > AT_REST and seconds > STANDS_S) else ""

    def usable(self, estimate: Estimate) -> Estimate:
        """Return an estimate whose numbers have their types; the last accepted one if that is impossible.

        Parameters
        ----------
        estimate : newest estimate.

        Raises
        ------
        ConfigError : a number is none, or out of its bounds, and none was accepted before.
        """
        try:
            return exact(estimate)
        except ConfigError as error:
            if self.accepted is None:
                raise
            self.rejected[str(error)] += 1
            self._last = estimate, str(error)
            return self.accepted

    def restart(self) -> None:
        """Begin with another source: its next plausible estimate is accepted, and its period is its own."""
        self.accepted = self._jumped = None
        self.age, self._last = InputAge(), (None, "")
        self.filter = EstimateFilter(self._vehicle)

    def select(self, newest: Estimate) -> Estimate | None:
        """Return the newest accepted estimate, with its position filtered if it is noisy; None before the first.

        Parameters
        ----------
        newest : estimate that was received last.
        """
        self.growth_m = 0.0
        of = newest if self.check(newest) in {TOO_FAST, TURNS_TOO_FAST} else self.accepted
        used = (
            None if of is None else self.filter.update(of)
        )  # an impossible rate, too: once it has failed, it is no reason
        return used if of is self.accepted else self.accepted

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
        if not vn * vn + ve * ve <= bounds.speed_mps * bounds.speed_mps and not self.filter.velocity.failed:
            return TOO_FAST
        if not abs(e.yaw_rate_radps) <= bounds.yaw_rate_radps and not self.filter.yaw_rate.failed:
            return TURNS_TOO_FAST
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
        if self.filter.velocity.failed:
            old = msgspec.structs.replace(old, velocity_north_mps=0.0, velocity_east_mps=0.0)
        if self.filter.yaw_rate.failed:
            old = msgspec.structs.replace(old, yaw_rate_radps=0.0)
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


def _motion(e: Estimate) -> tuple[float | None, ...]:
    rates = e.velocity_north_mps, e.velocity_east_mps, e.yaw_rate_radps
    return e.north_m, e.east_m, e.depth_m, e.heading_rad, *rates


def _problem(profile: CurrentProfile) -> str:
    """Return what makes a profile of the current useless; empty if nothing does."""
    reason = relation_reason(profile)
    if reason is not None:
        return f"current: {reason}"
    north, east = profile.north_mps, profile.east_mps
    return "" if math.isfinite(np.vdot(north, north) + np.vdot(east, east)) else NOT_FINITE
