"""Disturbance observer: what the vehicle's motion says of the water, of the estimated point and of the vehicle file.

The controller uses the estimate's current profile plus a bias b (2,), north and east, the same at all depths; without a
profile the bias is the whole current. A profile is trusted: the velocity over ground of a navigation filter has the
same error as its profile, so that the velocity through the water is right, and no bias is needed. A bias of a profile
is small and slow at first, and as far as it is not significant it is not used and fades. Forces that last make it
significant: wind, a profile that is wrong. The estimates may describe a point that is l (2,), forward and starboard,
away from the declared one: an antenna, or a hull that turns about another point than the model. Masses, drag and yaw
moment may be others than the vehicle file says: q (8,). An error of the file is fixed to the body and a current to the
earth, so turns and changes of speed tell them apart; one filter estimates all of them (``disturbance_filter.py``), and
the controller predicts and plans with the model that it has learned.

When the vehicle drifts with the water, drag is zero to first order, so b is unobservable; its variance is then bounded
by the prior. A steady course shows nothing of l and q. An arm is used as far as it is significant, so that a vehicle
with the declared point keeps it (``_significance``). What was tried: docs/notes/lever-arm.md, docs/notes/wrong-file.md.

Waves that carry the vehicle to and fro are filtered out (``wave_filter.py``): position and velocity are those of the
slow motion. When larger waves begin to show, arm and model return to the prior: they were learned from waves.

A thruster that delivers less than it reports looks like a current, and so do actuators that follow no plan. While a
loss of thrust is in doubt (``thrust_loss_detector.py``), the belief is that of ``DOUBTED_ESTIMATES`` before, and it is
not updated. While the actuators contradict the plans (``actuator_check.py``), it is that of their last report that
agreed. Under an override of the thrusts it keeps its value, and its variance grows.
"""

from __future__ import annotations

import math
from collections import deque
from functools import cache
from typing import TypeAlias

import msgspec
import numpy as np

from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.disturbance_filter import ARM, CURRENT, MODEL, STATES, adapted, propagate, update_belief
from ltv_mpc.control.prediction import STILL_WATER, Prediction, currents_at_depths, profile_of
from ltv_mpc.control.wave_filter import BAND_RADPS, INNOVATION, MOST, MOVED, NIS, SIZE, SQUARE
from ltv_mpc.messages import Array, DisturbanceState, Estimate
from ltv_mpc.references.limits import path_limits
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.reference_point import ReferencePoint

DEFAULT_SD_MPS = 0.15
"""Prior standard deviation of the bias if the estimates have no current profile (m/s). A tighter one makes a lever arm
of a strong current, and a wider one makes a current of the model's error in the first seconds.
"""

PROFILE_SD_MPS, PROFILE_WALK_MPS_PER_RTS, FADING_S = 0.02, 0.001, 10.0
"""Prior standard deviation and random walk of the bias of a profile, and time constant with which it fades."""

NOISE_SHARE, YIELDS, CARRIED = 0.0015, 40.0, 400.0
"""Default noise of the velocity over ground, over the top speed: what is unmodelled grows with a vehicle's speed. And
variances of the velocity by waves, over that of the noise: that to which the vehicle yields, beyond what an undeclared
arm or a thruster that is suddenly weak looks like; and that by which the waves carry the vehicle.
"""

ARM_WALK_M_PER_RTS = 1e-3
"""Random walk of the lever arm: it is fixed to the hull, but the pivot of a hull depends on its motion."""

NOISE_RADPS = 0.003
"""Default noise of the yaw rate."""

MODEL_WALK_PER_RTS = 0.01
"""Random walk of each model state: the drag of a boat changes with its speed and its load."""

MODEL_SD_RATIOS = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.5, 1.0])
"""Prior standard deviations of the model over the one that is set: the drag in yaw is known worst."""

MOMENT_SHARE, MOMENT_WALK_PER_RTS = 0.1, 0.03
"""Prior standard deviation and random walk of the steady yaw moment, over that of both thrusters."""

INSIGNIFICANT, SIGNIFICANT = 0.5, 2.0
"""Square of a component of the arm over its variance: up to the first nothing is used, from the second on all. In the
same way the bias of a profile is used, and an untold current by its square over that of a false one.
"""

HEADING_FREE_SHARE, SHIFT_TIME_S, SHIFT_WAY_M = 0.03, 15.0, 2.0
"""Speed through the water, over the top speed, below which the heading is free; and time or way in which another point
of the vehicle is brought to the target.
"""

RESTING_RADPS, FELT_SHARE = 0.01, 0.4
"""Yaw rate below which a vehicle in still water rests, and size of a false current, over ``heading_free_mps``: a hull
whose drag at rest is not that of its file shows one of up to 2 cm/s that turns with the hull, and the hull with it.
"""

VELOCITY_ERROR_TIME_S = 3.0
"""tau: time constant of the error of an estimated velocity. With realistic sensors this error is 1 cm/s while the
filter learns the biases of the profiler. With a constant error in the noise model, the thrust-loss detector gave a
false alarm in 12 of 24 runs with mismatch, in their first half minute.
"""

MAX_INTERVAL_NS = 2_000_000_000
"""Longest time between two estimates that are compared: beyond it the model predicts the velocity too badly."""

DOUBTED_ESTIMATES = 17
"""Number of estimates before thrust is in doubt whose updates can be taken back: 5 s at 0.3 s."""

ERROR_TIME_S, ERROR_MEMORY_S = 1.5, 30.0
"""Time constants of the mean innovation, and of the decay of its largest value: an approach at constant speed shows
nothing of the error with which the vehicle will stop.
"""

Belief: TypeAlias = tuple[Array, Array]
"""Mean and covariance: of the bias, (2,) north and east (m/s) and (2, 2), or of all states b, l, q."""


@cache
def heading_free_mps(vehicle: Vehicle) -> float:
    """Return the speed through the water below which the heading of a vehicle at a point is free (m/s).

    Parameters
    ----------
    vehicle : gives the top speed.
    """
    return HEADING_FREE_SHARE * path_limits(vehicle).top_mps


def velocity_variance(estimate: Estimate) -> float:
    """Return the variance of either component of the velocity over ground (m^2/s^2); 0 if unknown or negative.

    Parameters
    ----------
    estimate : with or without a covariance.
    """
    P = estimate.covariance
    return 0.0 if P is None else max(0.5 * float(P[2, 2] + P[3, 3]), 0.0)


def velocity_change_variance(before: float, after: float, seconds: float) -> float:
    """Return the variance of the error of the change of velocity between two estimates (m^2/s^2).

        s^2 = max(P0 - P1, 0) + 2 P1 dt/tau

    A correction of the velocity by the filter shows as a fall of its variance. The remaining error varies within P1,
    with time constant tau.

    Parameters
    ----------
    before, after : variances P0 and P1 of either component of the velocity (m^2/s^2).
    seconds : time dt between the two estimates (s).
    """
    return max(before - after, 0.0) + 2.0 * after * seconds / VELOCITY_ERROR_TIME_S


class DisturbanceObserver:
    """Observer of the current's bias, the lever arm and the model, updated from estimate to estimate."""

    def __init__(self, settings: Disturbance, vehicle: Vehicle, mean: Array | None = None) -> None:
        """Begin at the prior; with a standard deviation of 0 there never is a bias, an arm, or another model.

        Parameters
        ----------
        settings : [controller.disturbance].
        vehicle : from its file.
        mean : (12,) states to begin with; None: those of the file in still water.
        """
        self._settings = settings
        top_mps = path_limits(vehicle).top_mps
        noise_mps = settings.noise_mps or NOISE_SHARE * top_mps
        self._noise = noise_mps**2, NOISE_RADPS**2, settings.max_mps or top_mps
        self._heading_free_mps = heading_free_mps(vehicle)
        self._file = np.array(vehicle.coefficients())
        port, starboard = (thruster.max_N * thruster.arm_m for thruster in vehicle.thrusters[:2])
        learns_model = settings.model_sd > 0.0
        turning_radps2 = (port + starboard) / vehicle.yaw.inertia_kgm2 * learns_model  # at full thrust
        sd = np.full(STATES, settings.lever_arm_sd_m)
        sd[CURRENT:ARM] = DEFAULT_SD_MPS if settings.sd_mps is None else settings.sd_mps
        sd[MODEL:-1], sd[-1] = settings.model_sd * MODEL_SD_RATIOS, MOMENT_SHARE * turning_radps2
        self._other_bias = np.zeros(2)  # of a profile while the estimates have none, or of still water
        walks = np.zeros(STATES)  # of the arm and the model, per second
        walks[ARM:MODEL] = ARM_WALK_M_PER_RTS**2
        walks[MODEL:] = MODEL_WALK_PER_RTS**2 * learns_model
        walks[-1] = (MOMENT_WALK_PER_RTS * turning_radps2) ** 2
        self._prior_and_walks = sd**2, walks
        self._belief: Belief = np.zeros(STATES) if mean is None else mean * (sd > 0.0), np.diag(sd**2)
        # Noise, as ``update_belief`` takes it; and the model's error (m/s^2): mean ahead, to starboard, largest.
        self._track = np.zeros((SIZE + 1, 3))
        self._last: tuple[Estimate, Estimate] | None = None  # as it was given, and with filtered velocities
        self._shift = 0j  # from the origin to the point that is held in its place, north + j east (m)
        # After each update, the oldest first: time of the estimate, belief.
        self._before: deque[tuple[int, Belief]] = deque(maxlen=DOUBTED_ESTIMATES)
        self.thrust_in_doubt = False
        """A thruster may deliver less than the controller takes it to deliver."""

    @property
    def current(self) -> Belief | None:
        """Estimated bias of the current and its covariance; None if there never is a bias."""
        return None if self._settings.sd_mps == 0 else (self.bias_mps, self.covariance)

    @property
    def bias_mps(self) -> Array:
        """Estimated bias (2,), north and east (m/s)."""
        return self._belief[0][CURRENT:ARM].copy()

    @property
    def nis(self) -> float:
        """Normalised innovation squared of the last update, of three degrees of freedom."""
        return float(self._track[NIS, 0])

    @property
    def is_bounded(self) -> bool:
        """True while a component of the bias is at its bound: there is more to explain than a current."""
        return bool(np.abs(self.bias_mps).max() >= self._noise[2])

    @property
    def model_error_mps2(self) -> float:
        """Acceleration that the model has not explained lately, beyond the noise: from the mean innovation (m/s^2)."""
        return float(self._track[SIZE, 2])

    @property
    def waves_m(self) -> float:
        """Standard deviation of the displacement by waves, to which the vehicle yields (m)."""
        return self._waves_share * math.sqrt(self._track[SQUARE, 0]) / BAND_RADPS

    @property
    def in_waves(self) -> bool:
        """True while waves carry the vehicle to and fro with more than noise: its motion shows little of its file."""
        return bool(self._track[SQUARE, 0] > CARRIED * self._noise[0])

    @property
    def _waves_share(self) -> float:
        """Share of the displacement by waves that is used: more than what an arm or a wrong model looks like."""
        return _significance(float(self._track[SQUARE, 0]) / (YIELDS * self._noise[0]))

    @property
    def covariance(self) -> Array:
        """Covariance (2, 2) of the bias (m^2/s^2)."""
        return self._belief[1][CURRENT:ARM, CURRENT:ARM].copy()

    @property
    def coefficients(self) -> Array:
        """Coefficients (21,) of the vehicle with the learned model."""
        adapted_to: Array = adapted(self._file, self._belief[0][MODEL:])
        return adapted_to

    def covariance_of_mean(self, seconds: float) -> Array:
        """Return the covariance (2, 2) of the mean of the bias from the last estimate on (m^2/s^2).

        It is zero if that estimate has a profile that is trusted: its own deviations count.

        Parameters
        ----------
        seconds : length of the mean (s).
        """
        if self._last is None or self._settings.sd_mps == 0 or self._trusts(self._last[0]):
            return np.zeros((2, 2))
        sinking_m = abs(self._last[0].velocity_down_mps or 0.0) * seconds
        return self.covariance + self._walk(seconds, sinking_m) / 3.0 * np.eye(2)

    def correct(self, estimate: Estimate, prediction: Prediction, *, learns: bool = True) -> Estimate:
        """Update the belief with an estimate, and correct the estimate.

        Parameters
        ----------
        estimate : the newest one.
        prediction : knows the vehicle, the commands in force and the actuators' reports.
        learns : False: the belief is not updated, and its variance grows.

        Returns
        -------
        The estimate with the velocity of the vehicle's origin and the corrected current. Its position is that of the
        origin in still water, and goes over to that of the estimated point where the heading is given. The estimate
        itself if nothing is to be corrected.
        """
        given, (before, last) = estimate, self._last or (estimate, None)
        interval_ns = 0 if last is None else estimate.t_ns - last.t_ns
        if last is not None and self._trusts(last) is not self._trusts(estimate):
            self._exchange_bias()
        if self.thrust_in_doubt and self._before:
            _, self._belief = self._before[0]
            self._before.clear()
        if last is not None and interval_ns == 0 and _motion(given) == _motion(before):
            estimate = _with_motion(estimate, *_motion(last))
        elif last is not None and interval_ns > 0:
            compares = interval_ns <= MAX_INTERVAL_NS and (last.current is None) is (estimate.current is None)
            if learns and compares and not self.thrust_in_doubt:
                most = self._track[MOST, 0]
                estimate = self._update(last, estimate, prediction)
                if self._waves_share > 0.0 and self._track[MOST, 0] > most:  # they have looked like arm and model
                    self.forget_vehicle()
                self._before.append((estimate.t_ns, self._belief))
            else:
                self._belief = self._belief[0], self._propagated(last, estimate)
                self._track[INNOVATION : NIS + 1] = 0.0
        self._last = given, estimate
        at_origin = self.arm_in_use.to_origin(estimate)
        bias_mps = self._share_in_use(estimate) * self.bias_mps
        if self._settings.sd_mps != 0 and (estimate.current is None or bias_mps.any()):
            at_origin = _with_bias(at_origin, *bias_mps.tolist())
        return self._at_held_point(at_origin, estimate, interval_ns * 1e-9)

    def _at_held_point(self, at_origin: Estimate, estimate: Estimate, seconds: float) -> Estimate:
        """Return the estimate of the origin, moved by the shift to the point that is held in its place.

        In a current, and on a path, the vehicle lies along the velocity w through the water, so the shift becomes the
        arm in that direction. If it followed the heading, it would swing with it, and the vehicle with the shift. In
        still water the heading is the only direction, and a target that turns with the vehicle would make it turn for
        ever: there the origin is held while it turns. At rest the shift becomes the forward part of the arm, which a
        move ahead or astern brings to the target.
        """
        arm = complex(self.arm_in_use.forward_m, self.arm_in_use.starboard_m)
        moved = self._waves_share * complex(*self._track[MOVED, :2])
        if not arm and not self._shift and not moved:
            return at_origin
        over_ground = complex(at_origin.velocity_north_mps, at_origin.velocity_east_mps)
        c = currents_at_depths(at_origin.current, np.array([estimate.depth_m or 0.0]))[0]
        w, bow = over_ground - complex(*c), complex(math.cos(estimate.heading_rad), math.sin(estimate.heading_rad))
        free2 = self._heading_free_mps**2
        along = (w * bow.conjugate()).real * w * arm  # also with the stern first
        at_rest = free2 * bow * arm.real if abs(estimate.yaw_rate_radps) < RESTING_RADPS else 0.0
        share = min(seconds * (1.0 / SHIFT_TIME_S + abs(over_ground) / SHIFT_WAY_M), 1.0)
        self._shift += share * ((along + at_rest) / (abs(w) ** 2 + free2) - self._shift)
        held = complex(at_origin.north_m, at_origin.east_m) + self._shift - moved
        return msgspec.structs.replace(at_origin, north_m=held.real, east_m=held.imag)

    @property
    def arm_in_use(self) -> ReferencePoint:
        """Lever arm that corrects the estimates: the significant part of the estimated one."""
        mean, P = self._belief
        forward_m, starboard_m = (
            float(mean[i]) * _significance(float(mean[i] ** 2 / max(P[i, i], 1e-12))) for i in (ARM, ARM + 1)
        )
        return ReferencePoint(forward_m=forward_m, starboard_m=starboard_m)

    def forget_vehicle(self) -> None:
        """Return arm and model to the prior."""
        self._belief = self._belief[0] * (np.arange(STATES) < ARM), np.diag(self._prior_and_walks[0])
        self._before.clear()

    def take_back(self, t_ns: int) -> None:
        """Take back the updates by estimates that are newer than a time, as far as they are known.

        Parameters
        ----------
        t_ns : vehicle time (ns).
        """
        while len(self._before) > 1 and self._before[-1][0] > t_ns:
            self._before.pop()
        if self._before:
            _, self._belief = self._before[-1]

    def _trusts(self, estimate: Estimate) -> bool:
        """Return True for an estimate with a profile whose bias has to prove itself."""
        return self._settings.sd_mps is None and estimate.current is not None

    def _share_in_use(self, estimate: Estimate) -> float:
        """Return the share of the bias that is used: of an untold current, what is more than a false one."""
        b = self.bias_mps
        if self._trusts(estimate):
            return _significance(float(b @ np.linalg.solve(self.covariance, b)))
        if estimate.current is not None:
            return 1.0
        return _significance(float(b @ b) / (FELT_SHARE * self._heading_free_mps) ** 2)

    def _exchange_bias(self) -> None:
        """Go over to the bias of a profile from that of still water, or back; it is uncertain again."""
        mean, P = (part.copy() for part in self._belief)
        mean[CURRENT:ARM], self._other_bias = self._other_bias, mean[CURRENT:ARM].copy()
        P[CURRENT:ARM], P[:, CURRENT:ARM] = 0.0, 0.0
        P[CURRENT:ARM, CURRENT:ARM] = np.diag(self._prior_and_walks[0][CURRENT:ARM])
        self._belief = mean, P
        self._before.clear()

    def _walk(self, seconds: float, depth_m: float) -> float:
        """Return the variance of the bias's walk over a time and a change of depth (m^2/s^2)."""
        return self._settings.walk_mps_per_rts**2 * seconds + self._settings.walk_mps_per_rtm**2 * depth_m

    def _propagated(self, last: Estimate, estimate: Estimate) -> Array:
        """Return the covariance after the walks from one estimate to the next."""
        seconds = (estimate.t_ns - last.t_ns) * 1e-9
        known = last.depth_m is not None and estimate.depth_m is not None
        depth_m = abs(estimate.depth_m - last.depth_m) if known else 0.0  # type: ignore[operator]
        prior, walks = self._prior_and_walks
        walks = walks * seconds
        if self._trusts(estimate):
            prior = prior.copy()
            prior[CURRENT:ARM], walks[CURRENT:ARM] = PROFILE_SD_MPS**2, PROFILE_WALK_MPS_PER_RTS**2 * seconds
        elif self._settings.sd_mps != 0:
            walks[CURRENT:ARM] = self._walk(seconds, depth_m)
        covariance: Array = propagate(self._belief[1], walks, prior)
        return covariance

    def save(self) -> DisturbanceState:
        """Return the belief, from which another observer continues."""
        return DisturbanceState(mean=self._belief[0].copy(), covariance=self._belief[1].copy())

    def restore(self, state: DisturbanceState | None, age_ns: int) -> None:
        """Continue from the belief of another observer.

        Parameters
        ----------
        state : saved belief; None keeps this observer's.
        age_ns : time since it was saved (ns): all states have walked since.
        """
        if state is None:
            return
        seconds = max(age_ns, 0) * 1e-9
        P = state.covariance + np.diag(self._prior_and_walks[1]) * seconds
        P[CURRENT:ARM, CURRENT:ARM] += self._walk(seconds, 0.0) * np.eye(2)
        known = self._prior_and_walks[0] > 0.0  # what this observer's settings estimate
        # The next update bounds the variances by the prior.
        self._belief = np.where(known, state.mean, 0.0), np.where(np.outer(known, known), P, 0.0)

    def _update(self, last: Estimate, estimate: Estimate, prediction: Prediction) -> Estimate:
        """Update the belief with the change from the last estimate, and return the newest with filtered velocities."""
        later = last.current and (estimate.current or last.current)
        seconds = (estimate.t_ns - last.t_ns) * 1e-9
        s2 = velocity_change_variance(velocity_variance(last), velocity_variance(estimate), seconds)
        north, east, yaw_rate = _motion(estimate)
        mean, P, north, east, yaw_rate = update_belief(
            (self._belief[0], self._propagated(last, estimate)),
            (estimate.t_ns, north, east, estimate.heading_rad, yaw_rate),
            self._file,
            prediction.measured(last),
            prediction.delivered,
            (profile_of(last.current), profile_of(later)),
            (self._noise[0] + s2, *self._noise[1:], self._settings.sd_mps != 0),
            self._track,
        )
        self._belief = mean, P
        if self._trusts(estimate):  # what is not significant fades
            mean[CURRENT:ARM] *= 1.0 - (1.0 - self._share_in_use(estimate)) * min(seconds / FADING_S, 1.0)
        share = min(seconds / ERROR_TIME_S, 1.0)
        self._track[SIZE, :2] += share * (self._track[INNOVATION, :2] / seconds - self._track[SIZE, :2])
        noise = 2.0 * math.sqrt(0.5 * share * (self._noise[0] + s2)) / seconds
        kept = self.model_error_mps2 * max(1.0 - seconds / ERROR_MEMORY_S, 0.0)
        self._track[SIZE, 2] = max(float(np.hypot(*self._track[SIZE, :2])) - noise, kept)
        return _with_motion(estimate, north, east, yaw_rate)


def _with_motion(estimate: Estimate, north: float, east: float, yaw_rate: float) -> Estimate:
    """Return the estimate with another velocity, north and east (m/s), and yaw rate (rad/s)."""
    return msgspec.structs.replace(estimate, velocity_north_mps=north, velocity_east_mps=east, yaw_rate_radps=yaw_rate)


def _motion(estimate: Estimate) -> tuple[float, float, float]:
    """Return velocity north and east (m/s), and yaw rate (rad/s)."""
    return estimate.velocity_north_mps, estimate.velocity_east_mps, estimate.yaw_rate_radps


def _significance(square: float) -> float:
    """Return 0 for noise to 1 for a state that is significant, by its square over its variance."""
    return min(max((square - INSIGNIFICANT) / (SIGNIFICANT - INSIGNIFICANT), 0.0), 1.0)


def _with_bias(estimate: Estimate, north: float, east: float) -> Estimate:
    """Return the estimate with a bias (m/s) added to its current profile, or to still water if it has none."""
    known = estimate.current or STILL_WATER
    current = msgspec.structs.replace(known, north_mps=known.north_mps + north, east_mps=known.east_mps + east)
    return msgspec.structs.replace(estimate, current=current)
