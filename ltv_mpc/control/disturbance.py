"""Disturbance observer: a bias of the current, and the lever arm to the point that the estimates describe.

The controller uses the estimate's current profile plus a bias b (2,), north and east, the same at all depths; without a
profile the bias is the whole current. The estimates may describe a point that is l (2,), forward and starboard, away
from the declared one: an antenna, or a hull that turns about another point than the model. Both are random walks, and
they are observed in the change of the velocity over ground v (2,) from one estimate to the next:

    b(t + dt) = b(t) + w,   w ~ N(0, (q_t^2 dt + q_z^2 |dz|) I)                 with time, and with depth z
    v(t + dt) = h(b, l) + R(psi) e,   e ~ N(0, diag(a_u, a_v)^2 + (r^2 + s^2) I)
    h(b, l)   = v_o(b, v - r R S l) + r' R' S l                         S = [[0, -1], [1, 0]], so that dR/dpsi = R S

v_o is the velocity of the vehicle's origin after the exact flow through the commands that were sent; r and R belong to
the last estimate, r' and R' to this one. This is an iterated extended Kalman filter with four states. Iterated, because
drag is quadratic: a linear correction of a large error of the current stops halfway and is sure of it. s^2 is the
variance of the error of the estimated change (``velocity_change_variance``), so that the noise of a navigation filter
is not taken for a current. a_u and a_v are the errors of the model in surge and sway, as shares of the forces that act.

When the vehicle drifts with the water, drag is zero to first order, so dh/db vanishes and b is unobservable; its
variance is then bounded by the prior. A steady course shows nothing of l. An arm is used as far as it is significant,
so that a vehicle with the declared point keeps it (``_significant``). What was tried: docs/notes/lever-arm.md.

A thruster that delivers less than it reports looks like a current, and so do actuators that follow no plan. While a
loss of thrust is in doubt (``thrust_loss_detector.py``), the belief is that of ``DOUBTED_ESTIMATES`` before, and it is
not updated. While the actuators contradict the plans (``actuator_check.py``), it is that of their last report that
agreed. Under an override of the thrusts it keeps its value, and its variance grows.

By default the bias works for estimates without a current profile, and does nothing for estimates with one.
Source: Bar-Shalom, Li & Kirubarajan 2001, Estimation with applications to tracking and navigation, section 10.5.2.
"""

from __future__ import annotations

from collections import deque
from typing import TypeAlias

import msgspec
import numpy as np

from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.prediction import Measured, Prediction, Profile, current_at_depth, predict_state, profile_of
from ltv_mpc.control.sent_commands import Commands, SentCommands
from ltv_mpc.jit import copy_to, jit, jit_outlined
from ltv_mpc.messages import Array, CurrentBiasState, CurrentProfile, Estimate, LeverArmState
from ltv_mpc.references.limits import path_limits
from ltv_mpc.vehicle.dynamics import coefficients
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.reference_point import ReferencePoint

STEPS = (0.005, 0.005, 0.01, 0.01)
"""Steps of the finite differences dh/d(b, l) (m/s, m), and the changes at which the iteration ends."""

MAX_ITERATIONS, ITERATED_SQUARE = 5, 16.0
"""Iterations of an update whose innovation is more than its noise explains, by the normalised square. An ordinary one
is linear: iterated, the noise of a drifting vehicle, of which dh/db is zero, would be learned as a current.
"""

STILL_WATER = CurrentProfile(depth_m=np.zeros(1), north_mps=np.zeros(1), east_mps=np.zeros(1))
"""Profile that the bias is added to if the estimate has none."""

DEFAULT_SD_MPS = 0.15
"""Prior standard deviation of the bias if the estimates have no current profile (m/s). A tighter one makes a lever arm
of a strong current, and a wider one makes a current of the model's error in the first seconds.
"""

NOISE_SHARE = 0.0015
"""Default noise of the velocity over ground, over the top speed: what is unmodelled grows with a vehicle's speed."""

ARM_WALK_M_PER_RTS = 1e-3
"""Random walk of the lever arm: it is fixed to the hull, but the pivot of a hull depends on its motion."""

SURGE_ERROR, SWAY_ERROR = 0.5, 0.1
"""Errors of the model as shares of the forces that act. An error of thrust or drag lasts for seconds: 11 % for 3 s
weighs as much as 50 % that is new in each estimate.
"""

INSIGNIFICANT, SIGNIFICANT = 1.0, 4.0
"""Square of a component of the arm over its variance: up to the first nothing is used, from the second on all."""

HEADING_FREE_SHARE, SHIFT_TIME_S, SHIFT_WAY_M = 0.03, 15.0, 2.0
"""Speed through the water over the top speed, below which the heading is free; and time or way in which the estimated
point is brought to where the origin is. In a current, or on a path, the heading is given, so the estimated point is the
one that is held. At rest in still water a target that turns with the vehicle would make it turn for ever.
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

Belief: TypeAlias = tuple[Array, Array]
"""Mean and covariance: of the bias, (2,) north and east (m/s) and (2, 2), or of all four states b, l."""


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
    """Iterated extended Kalman filter of the current's bias and of the lever arm, updated from estimate to estimate."""

    def __init__(self, settings: Disturbance, vehicle: Vehicle) -> None:
        """Begin at the prior; with a standard deviation of 0 there never is a bias, or a lever arm."""
        self._settings = settings
        top_mps = path_limits(vehicle).top_mps
        self._variance = (settings.noise_mps or NOISE_SHARE * top_mps) ** 2
        self._heading_free_mps = HEADING_FREE_SHARE * top_mps
        sd_mps = DEFAULT_SD_MPS if settings.sd_mps is None else settings.sd_mps
        self._prior = np.array([sd_mps, sd_mps, settings.lever_arm_sd_m, settings.lever_arm_sd_m]) ** 2
        self._belief: Belief = np.zeros(4), np.diag(self._prior)
        self._last: Estimate | None = None
        self._shift = np.zeros(2)  # from the origin to the point that is held in its place, north and east (m)
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
        return self._belief[0][:2].copy()

    @property
    def covariance(self) -> Array:
        """Covariance (2, 2) of the bias (m^2/s^2)."""
        return self._belief[1][:2, :2].copy()

    @property
    def lever_arm(self) -> Belief:
        """Estimated lever arm (2,), forward and starboard (m), and its covariance (2, 2) (m^2)."""
        return self._belief[0][2:].copy(), self._belief[1][2:, 2:].copy()

    def covariance_of_mean(self, seconds: float) -> Array:
        """Return the covariance (2, 2) of the mean of the bias from the last estimate on (m^2/s^2).

        It is zero if the profile of that estimate is used as it is.

        Parameters
        ----------
        seconds : length of the mean (s).
        """
        last = self._last
        if last is None or not self._applies_to(last):
            return np.zeros((2, 2))
        sinking_m = abs(last.velocity_down_mps or 0.0) * seconds
        return self.covariance + self._walk(seconds, sinking_m) / 3.0 * np.eye(2)

    def correct(
        self, estimate: Estimate, prediction: Prediction, commands: SentCommands, *, learns: bool = True
    ) -> Estimate:
        """Update the belief with an estimate, and correct the estimate.

        Parameters
        ----------
        estimate : the newest one.
        prediction : knows the vehicle and the actuators' reports.
        commands : commands in force since the last estimate.
        learns : False: the belief is not updated, and its variance grows.

        Returns
        -------
        The estimate with the velocity of the vehicle's origin and the corrected current. Its position is that of the
        origin in still water, and goes over to that of the estimated point where the heading is given. The estimate
        itself if nothing is to be corrected.
        """
        last, self._last = self._last, estimate
        interval_ns = 0 if last is None else estimate.t_ns - last.t_ns
        if self.thrust_in_doubt and self._before:
            _, self._belief = self._before[0]
            self._before.clear()
        if last is not None and interval_ns > 0:
            compares = interval_ns <= MAX_INTERVAL_NS and (last.current is None) is (estimate.current is None)
            if learns and compares and not self.thrust_in_doubt:
                self._update(last, estimate, prediction, commands)
                self._before.append((estimate.t_ns, self._belief))
            else:
                self._belief = self._belief[0], propagate(self._belief[1], *self._growth(last, estimate), self._prior)
        at_origin = self.arm_in_use.to_origin(estimate)
        if self._applies_to(estimate):
            at_origin = _with_bias(at_origin, *self._belief[0][:2].tolist())
        return self._at_held_point(at_origin, estimate, interval_ns * 1e-9)

    def _at_held_point(self, at_origin: Estimate, estimate: Estimate, seconds: float) -> Estimate:
        """Return the estimate of the origin, moved towards the estimated point as far as the heading is given."""
        arm = np.array((estimate.north_m - at_origin.north_m, estimate.east_m - at_origin.east_m))
        if not arm.any() and not self._shift.any():
            return at_origin
        over_ground = np.array((at_origin.velocity_north_mps, at_origin.velocity_east_mps))
        current = profile_of(at_origin)
        c = current_at_depth(current.depth_m, current.north_mps, current.east_mps, estimate.depth_m or 0.0)
        square = float(((over_ground - c) ** 2).sum())
        rate = 1.0 / SHIFT_TIME_S + float(np.hypot(*over_ground)) / SHIFT_WAY_M
        given = square / (square + self._heading_free_mps**2)
        self._shift += min(seconds * rate, 1.0) * (given * arm - self._shift)
        north_m, east_m = (self._shift + np.array((at_origin.north_m, at_origin.east_m))).tolist()
        return msgspec.structs.replace(at_origin, north_m=north_m, east_m=east_m)

    @property
    def arm_in_use(self) -> ReferencePoint:
        """Lever arm that corrects the estimates: the significant part of the estimated one."""
        mean, P = self._belief
        forward_m, starboard_m = (_significant(float(mean[i]), float(P[i, i])) for i in (2, 3))
        return ReferencePoint(forward_m=forward_m, starboard_m=starboard_m)

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

    def _applies_to(self, estimate: Estimate) -> bool:
        """Return True if the bias is added to the estimate's current."""
        sd_mps = self._settings.sd_mps
        return sd_mps != 0 and (sd_mps is not None or estimate.current is None)

    def _walk(self, seconds: float, depth_m: float) -> float:
        """Return the variance of the bias's walk over a time and a change of depth (m^2/s^2)."""
        return self._settings.walk_mps_per_rts**2 * seconds + self._settings.walk_mps_per_rtm**2 * depth_m

    def _growth(self, last: Estimate, estimate: Estimate) -> tuple[float, float]:
        """Return the variances that the walks add to each component of b (m^2/s^2) and l (m^2)."""
        seconds = (estimate.t_ns - last.t_ns) * 1e-9
        known = last.depth_m is not None and estimate.depth_m is not None
        depth_m = abs(estimate.depth_m - last.depth_m) if known else 0.0  # type: ignore[operator]
        walk = self._walk(seconds, depth_m) if self._applies_to(estimate) else 0.0
        return walk, ARM_WALK_M_PER_RTS**2 * seconds

    def save(self) -> tuple[CurrentBiasState | None, LeverArmState | None]:
        """Return the beliefs of bias and lever arm, from which another observer continues; None where there is none."""
        mean, P = self._belief[0].tolist(), self._belief[1].tolist()
        bias = CurrentBiasState(bias_mps=(mean[0], mean[1]), covariance=(P[0][0], P[0][1], P[1][1]))
        arm = LeverArmState(arm_m=(mean[2], mean[3]), covariance=(P[2][2], P[2][3], P[3][3]))
        return bias if self._prior[0] else None, arm if self._prior[2] else None

    def restore(self, bias: CurrentBiasState | None, arm: LeverArmState | None, age_ns: int) -> None:
        """Continue from the beliefs of another observer.

        Parameters
        ----------
        bias, arm : saved beliefs; None keeps this observer's.
        age_ns : time since they were saved (ns): both have walked since.
        """
        mean, P = self._belief[0].copy(), self._belief[1].copy()
        seconds, max_mps = max(age_ns, 0) * 1e-9, self._settings.max_mps
        # The next update bounds the variances by the prior.
        if bias is not None:
            mean[:2] = np.clip(bias.bias_mps, -max_mps, max_mps)
            P[:2, :2] = _symmetric(bias.covariance) + self._walk(seconds, 0.0) * np.eye(2)
        if arm is not None:
            mean[2:] = arm.arm_m
            P[2:, 2:] = _symmetric(arm.covariance) + ARM_WALK_M_PER_RTS**2 * seconds * np.eye(2)
        self._belief = mean, P

    def _update(self, last: Estimate, estimate: Estimate, prediction: Prediction, commands: SentCommands) -> None:
        """Update the belief with the change of velocity from the last estimate."""
        profile = last.current or STILL_WATER
        later = profile if last.current is None else estimate.current or profile
        seconds = (estimate.t_ns - last.t_ns) * 1e-9
        s2 = velocity_change_variance(velocity_variance(last), velocity_variance(estimate), seconds)
        mean, P = self._belief
        self._belief = update_belief(
            mean,
            propagate(P, *self._growth(last, estimate), self._prior),
            (
                estimate.t_ns,
                estimate.velocity_north_mps,
                estimate.velocity_east_mps,
                estimate.heading_rad,
                estimate.yaw_rate_radps,
            ),
            prediction.coefficients,
            prediction.measured(last, commands),
            prediction.delivered(commands),
            (
                (profile.depth_m, profile.north_mps, profile.east_mps),
                (later.depth_m, later.north_mps, later.east_mps),
            ),
            (self._variance + s2, self._settings.max_mps, self._applies_to(last) and self._applies_to(estimate)),
        )


Newest: TypeAlias = tuple[int, float, float, float, float]
"""Time of the newest estimate (ns), its velocity over ground, north and east (m/s), heading (rad), yaw rate (rad/s)."""

Noise: TypeAlias = tuple[float, float, bool]
"""r^2 + s^2 (m^2/s^2), the largest bias in either direction (m/s), and False if the bias is not updated."""


@jit
def update_belief(
    mean: Array,
    P: Array,
    newest: Newest,
    vehicle: Array,
    measured: Measured,
    commands: Commands,
    profiles: tuple[Profile, Profile],
    noise: Noise,
) -> tuple[Array, Array]:
    """Update the belief with the newest velocity over ground: the measurement update of the filter.

    Parameters
    ----------
    mean, P : (4,), (4, 4) belief before the update.
    newest, noise : as their types say.
    vehicle, measured, commands : as ``predict_state`` takes them, from the last estimate.
    profiles : of the last and of the newest estimate, without the bias.

    Returns
    -------
    Mean (4,) and covariance (4, 4) after the update. An estimate whose numbers are not finite does not change them.
    """
    variance, max_mps, learns_current = noise
    cos, sin = np.cos(newest[3]), np.sin(newest[3])
    at, out, Q = mean.copy(), mean.copy(), P.copy()
    H, r2, z, g = np.zeros((2, 4)), np.empty(2), np.empty(2), np.empty(4)
    for iteration in range(MAX_ITERATIONS):
        north, east, surge_error, sway_error = _predicted_velocity(at, newest, vehicle, measured, commands, profiles)
        if iteration == 0:
            r2[0], r2[1] = variance + surge_error * surge_error, variance + sway_error * sway_error
        for j in range(0 if learns_current else 2, 4):
            shifted = at.copy()
            shifted[j] += STEPS[j]
            n, e, _, _ = _predicted_velocity(shifted, newest, vehicle, measured, commands, profiles)
            dn, de = (n - north) / STEPS[j], (e - east) / STEPS[j]
            # In the body frame the noise of the two components is independent, so they are used one after the other.
            H[0, j], H[1, j] = cos * dn + sin * de, cos * de - sin * dn
        dn, de = newest[1] - north, newest[2] - east
        z[0], z[1] = cos * dn + sin * de, cos * de - sin * dn
        copy_to(out, mean)
        Q = P.copy()
        for i in range(2):
            S, y = r2[i], z[i]
            for j in range(4):  # g = Q h, and y = z - H (x - at)
                g[j] = 0.0
                for k in range(4):
                    g[j] += Q[j, k] * H[i, k]
                S += H[i, j] * g[j]
                y -= H[i, j] * (out[j] - at[j])
            for j in range(4):
                out[j] += g[j] / S * y
            # Q - g g' / S, symmetric to the last bit; its walks keep it positive definite
            for j in range(4):
                for k in range(j + 1):
                    Q[j, k] -= g[j] * g[k] / S
                    Q[k, j] = Q[j, k]
        if not np.isfinite(out[0] + out[1] + out[2] + out[3]):
            return mean, P
        largest = 0.0
        for j in range(4):
            largest = max(largest, abs(out[j] - at[j]) / STEPS[j])
        ordinary = z[0] * z[0] / r2[0] + z[1] * z[1] / r2[1] <= ITERATED_SQUARE
        copy_to(at, out)
        if largest < 1.0 or (iteration == 0 and ordinary):
            break
    for j in range(2):
        out[j] = min(max(out[j], -max_mps), max_mps)
    return out, Q


@jit_outlined
def _predicted_velocity(
    state: Array,
    newest: Newest,
    vehicle: Array,
    measured: Measured,
    commands: Commands,
    profiles: tuple[Profile, Profile],
) -> tuple[float, float, float, float]:
    """Return h(b, l), north and east (m/s), and the errors a_u and a_v of the model (m/s), for the state b, l (4,)."""
    since, estimate, report_t_ns, reported_N = measured
    (depth, north, east), later = profiles
    origin = estimate.copy()
    arm_north, arm_east = _turning_velocity(state, estimate[2], estimate[3])
    origin[4] -= arm_north
    origin[5] -= arm_east
    end = predict_state(
        vehicle,
        (since, origin, report_t_ns, reported_N),
        newest[0],
        commands,
        (depth, north + state[0], east + state[1]),
    )
    before_north, before_east = current_at_depth(depth, north, east, end[11])
    current_north, current_east = current_at_depth(later[0], later[1], later[2], end[11])
    dn, de = current_north - before_north, current_east - before_east
    cos, sin = np.cos(end[4]), np.sin(end[4])
    p = coefficients(vehicle)
    # The change of the current with time carries the vehicle: M [u', v'] = ... - m R(psi)' c'
    u = end[2] - p.dry_mass / p.mass_surge * (cos * dn + sin * de)
    v = end[3] - p.dry_mass / p.mass_sway * (cos * de - sin * dn)
    # v = R(psi) [u, v] + c + r R S l
    arm_north, arm_east = _turning_velocity(state, newest[3], newest[4])
    over_north = cos * u - sin * v + current_north + state[0] + arm_north
    over_east = sin * u + cos * v + current_east + state[1] + arm_east
    seconds, r = float(newest[0] - since) * 1e-9, abs(end[5])
    surge_N = abs(end[6]) + abs(end[7]) + (p.linear_surge + p.quadratic_surge * abs(u)) * abs(u)
    surge_N += p.mass_sway * abs(v) * r
    sway_N = (p.linear_sway + p.quadratic_sway * abs(v)) * abs(v) + p.mass_surge * abs(u) * r
    surge_error, sway_error = SURGE_ERROR * surge_N * seconds, SWAY_ERROR * sway_N * seconds
    return over_north, over_east, surge_error / p.mass_surge, sway_error / p.mass_sway


@jit
def _turning_velocity(state: Array, heading: float, yaw_rate: float) -> tuple[float, float]:
    """Return r R S l, north and east (m/s): the velocity of the estimated point relative to the origin."""
    cos, sin = np.cos(heading), np.sin(heading)
    forward, starboard = -yaw_rate * state[3], yaw_rate * state[2]
    return cos * forward - sin * starboard, sin * forward + cos * starboard


@jit
def propagate(P: Array, walk: float, arm_walk: float, prior: Array) -> Array:
    """Return the covariance after the random walks; the largest variances of b and l are bounded by the prior.

    Parameters
    ----------
    P : (4, 4) covariance before.
    walk, arm_walk : variances that are added to each component of b (m^2/s^2) and l (m^2).
    prior : (4,) prior variances.

    Returns
    -------
    (4, 4) covariance. Directions that are not observed do not grow beyond the prior.
    """
    out = P.copy()
    for i, growth in ((0, walk), (2, arm_walk)):
        out[i, i] += growth
        out[i + 1, i + 1] += growth
        a, b, c = out[i, i], out[i, i + 1], out[i + 1, i + 1]
        largest = 0.5 * (a + c) + np.sqrt(0.25 * (a - c) ** 2 + b * b)
        scale = np.sqrt(prior[i] / largest) if largest > prior[i] else 1.0
        for j in range(4):
            for k in (i, i + 1):
                out[k, j] *= scale
                out[j, k] *= scale
    return out


def _significant(arm_m: float, variance: float) -> float:
    """Return the part of a component of the lever arm (m) that is used, by its variance (m^2)."""
    if arm_m == 0.0 or variance <= 0.0:
        return 0.0
    return arm_m * min(max((arm_m * arm_m / variance - INSIGNIFICANT) / (SIGNIFICANT - INSIGNIFICANT), 0.0), 1.0)


def _symmetric(entries: tuple[float, float, float]) -> Array:
    """Return a symmetric matrix (2, 2) by its entries 11, 12, 22."""
    first, cross, second = entries
    return np.array([[first, cross], [cross, second]])


def _with_bias(estimate: Estimate, north: float, east: float) -> Estimate:
    """Return the estimate with a bias (m/s) added to its current profile, or to still water if it has none."""
    known = estimate.current or STILL_WATER
    current = msgspec.structs.replace(known, north_mps=known.north_mps + north, east_mps=known.east_mps + east)
    return msgspec.structs.replace(estimate, current=current)
