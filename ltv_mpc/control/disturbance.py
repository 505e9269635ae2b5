"""Disturbance observer for offset-free control: a bias of the current that the profile does not contain.

The controller uses the estimate's current profile plus a bias b (2,), north and east, the same at all depths; without a
profile the bias is the whole current. It is a random walk, and it is observed in the change of the velocity over ground
v (2,) from one estimate to the next, through the drag on the motion relative to the water:

    b(t + dt) = b(t) + w,   w ~ N(0, q^2 dt I)
    v(t + dt) = h(b) + e,   e ~ N(0, (r^2 + s^2) I)

Here h is the exact flow from the last estimate through the commands that were sent: an extended Kalman filter with two
states. s^2 is the variance of the error of the estimated change (``velocity_change_variance``), so that the noise of a
navigation filter is not taken for a current. When the vehicle drifts with the water, drag is zero to first order, so
dh/db vanishes and b is unobservable; its variance is then bounded by the prior. Compared with an integrator of the
position error this is one more state, but it needs no anti-windup: it acts as a feed-forward through the model, and a
saturated thruster does not fill it.

A thruster that delivers less than it reports looks like a current, and so do actuators that follow no plan. While a
loss of thrust is in doubt (``thrust_loss_detector.py``), the bias is that of ``DOUBTED_ESTIMATES`` before, and it is
not updated. While the actuators contradict the plans (``actuator_check.py``), it is that of their last report that
agreed. Under an override of the thrusts it keeps its value, and its variance grows.

By default it works for estimates without a current profile, and does nothing for estimates with one.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TypeAlias

import msgspec
import numpy as np

from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.prediction import Measured, Prediction, Profile, current_at_depth, predict_state
from ltv_mpc.control.sent_commands import Commands, SentCommands
from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array, CurrentBiasState, CurrentProfile, Estimate, Pair
from ltv_mpc.vehicle.dynamics import coefficients

STEP_MPS = 0.005
"""Step of the finite difference dh/db (m/s)."""

STILL_WATER = CurrentProfile(depth_m=np.zeros(1), north_mps=np.zeros(1), east_mps=np.zeros(1))
"""Profile that the bias is added to if the estimate has none."""

DEFAULT_SD_MPS = 0.1
"""Prior standard deviation of the bias if the estimates have no current profile (m/s)."""

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
"""Estimated bias b (2,), north and east (m/s), and its covariance P (2, 2) (m^2/s^2)."""

FlatBelief: TypeAlias = tuple[float, float, float, float, float]
"""The same as numbers: b_n, b_e (m/s), P_nn, P_ne, P_ee (m^2/s^2)."""

NO_BIAS: FlatBelief = (0.0, 0.0, 0.0, 0.0, 0.0)
"""Belief where the profile is used as it is."""

Noise: TypeAlias = tuple[float, float, float, float]
"""Walk q (m/s per sqrt(s)), noise of the velocity r (m/s), the prior variance (m^2/s^2), which is the largest variance
in any direction, and the largest bias in either direction (m/s).
"""


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


class CurrentBias:
    """Extended Kalman filter of the current's bias, updated from estimate to estimate.

    Its prediction of the velocity is also that of the reference point check, so it predicts without a bias, too.
    """

    def __init__(self, settings: Disturbance) -> None:
        """Begin at the prior; with ``settings.sd_mps`` = 0 there never is a bias."""
        self._sd_mps = settings.sd_mps
        prior_variance = (DEFAULT_SD_MPS if settings.sd_mps is None else settings.sd_mps) ** 2
        self._noise: Noise = (settings.walk_mps_per_rts, settings.noise_mps, prior_variance, settings.max_mps)
        self._belief: FlatBelief = (0.0, 0.0, prior_variance, 0.0, prior_variance)
        self._last: Estimate | None = None
        # After each update, the oldest first: time of the estimate, belief.
        self._before: deque[tuple[int, FlatBelief]] = deque(maxlen=DOUBTED_ESTIMATES)
        self.thrust_in_doubt = False
        """A thruster may deliver less than the controller takes it to deliver."""

    @property
    def belief(self) -> Belief | None:
        """Estimated bias and its covariance; None if there never is a bias."""
        return None if self._sd_mps == 0 else (self.bias_mps, self.covariance)

    @property
    def bias_mps(self) -> Array:
        """Estimated bias (2,), north and east (m/s)."""
        return np.array(self._belief[:2])

    @property
    def covariance(self) -> Array:
        """Covariance (2, 2) of the bias (m^2/s^2)."""
        _, _, north, cross, east = self._belief
        return np.array([[north, cross], [cross, east]])

    def covariance_of_mean(self, seconds: float) -> Array:
        """Return the covariance (2, 2) of the mean of the bias from the last estimate on (m^2/s^2).

        It is zero if the profile of that estimate is used as it is.

        Parameters
        ----------
        seconds : length of the mean (s).
        """
        if self._last is None or not self._applies_to(self._last):
            return np.zeros((2, 2))
        return self.covariance + self._noise[0] ** 2 * seconds / 3.0 * np.eye(2)

    def correct(
        self, estimate: Estimate, prediction: Prediction, commands: SentCommands, *, learns: bool = True
    ) -> tuple[Estimate, Pair | None]:
        """Update the bias with an estimate, and add it to the estimate's current.

        Parameters
        ----------
        estimate : the newest one.
        prediction : knows the vehicle and the actuators' reports.
        commands : commands in force since the last estimate.
        learns : False: the bias is not updated, and its variance grows.

        Returns
        -------
        The estimate with the corrected current, unchanged if its profile is used as it is; and its velocity over
        ground, north and east (m/s), as predicted from the last estimate. It is None without one, and after too long a
        time.
        """
        last, self._last = self._last, estimate
        interval_ns = 0 if last is None else estimate.t_ns - last.t_ns
        applies = self._applies_to(estimate)
        if self.thrust_in_doubt and self._before:
            _, self._belief = self._before[0]
            self._before.clear()
        learns = learns and applies and not self.thrust_in_doubt
        predicted = None
        if last is not None and 0 < interval_ns <= MAX_INTERVAL_NS:
            learns = learns and (last.current is None) is (estimate.current is None)
            predicted = self._update(last, estimate, prediction, commands, learns=learns)
        else:
            learns = False
        if interval_ns > 0 and applies and not learns:
            self._belief = propagate(self._belief, interval_ns, self._noise)
        if learns:
            self._before.append((estimate.t_ns, self._belief))
        return _with_bias(estimate, *self._belief[:2]) if applies else estimate, predicted

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
        return self._sd_mps != 0 and (self._sd_mps is not None or estimate.current is None)

    def save(self) -> CurrentBiasState:
        """Return the belief, from which another filter continues."""
        return CurrentBiasState(bias_mps=self._belief[:2], covariance=self._belief[2:])

    def restore(self, state: CurrentBiasState, age_ns: int) -> None:
        """Continue from the belief of another filter.

        Parameters
        ----------
        state : saved belief.
        age_ns : time since it was saved (ns): the bias has walked since.
        """
        walk, _, _, max_mps = self._noise
        b_north, b_east = (min(max(b, -max_mps), max_mps) for b in state.bias_mps)
        north, cross, east = state.covariance
        growth = walk**2 * max(age_ns, 0) * 1e-9  # the next update bounds it by the prior
        self._belief = b_north, b_east, north + growth, cross, east + growth

    def _update(
        self, last: Estimate, estimate: Estimate, prediction: Prediction, commands: SentCommands, *, learns: bool
    ) -> Pair:
        """Return the velocity predicted from the last estimate, and update the bias if it learns."""
        profile = last.current or STILL_WATER
        later = profile if last.current is None else estimate.current or profile
        walk, noise_mps, prior_variance, max_mps = self._noise
        seconds, s2 = (estimate.t_ns - last.t_ns) * 1e-9, 0.0
        if learns:
            s2 = velocity_change_variance(velocity_variance(last), velocity_variance(estimate), seconds)
        north, east, *belief = predict_and_update(
            self._belief if self._applies_to(last) else NO_BIAS,
            (estimate.t_ns, estimate.velocity_north_mps, estimate.velocity_east_mps),
            prediction.coefficients,
            prediction.measured(last, commands),
            prediction.delivered(commands),
            (
                (profile.depth_m, profile.north_mps, profile.east_mps),
                (later.depth_m, later.north_mps, later.east_mps),
            ),
            (walk, math.sqrt(noise_mps**2 + s2), prior_variance, max_mps),
            learns,
        )
        if learns:
            self._belief = belief[0], belief[1], belief[2], belief[3], belief[4]
        return north, east


@jit
def predict_and_update(
    belief: FlatBelief,
    newest: tuple[int, float, float],
    vehicle: Array,
    measured: Measured,
    commands: Commands,
    profiles: tuple[Profile, Profile],
    noise: Noise,
    updates: bool,
) -> tuple[float, float, float, float, float, float, float]:
    """Predict the velocity over ground, and update the belief with the measured one: one step of the filter.

    Parameters
    ----------
    belief : before the step.
    newest : time of the newest estimate (ns), and its velocity over ground, north and east (m/s).
    vehicle, measured, commands : as ``predict_state`` takes them, from the last estimate.
    profiles : of the last and of the newest estimate, without the bias.
    noise : of the walk, of the velocity, the prior, and the bound of the bias.
    updates : False: only predict.

    Returns
    -------
    Predicted velocity over ground of the newest estimate, north and east (m/s), then the belief after the step. An
    estimate whose velocity is not finite does not change the belief.
    """
    b = np.array(belief[:2])
    until, velocity = newest[0], newest[1:]
    predicted = _predicted_velocity(b, until, vehicle, measured, commands, profiles)
    if not updates:
        return (*predicted, *belief)
    velocity_sd, max_mps = noise[1], noise[3]
    H = np.empty((2, 2))
    for j in range(2):  # one difference for each component of b
        shifted = b.copy()
        shifted[j] += STEP_MPS
        v = _predicted_velocity(shifted, until, vehicle, measured, commands, profiles)
        for i in range(2):
            H[i, j] = (v[i] - predicted[i]) / STEP_MPS
    out_b = b.copy()
    _, _, p00, p01, p11 = propagate(belief, until - measured[0], noise)
    r2 = velocity_sd * velocity_sd
    # The noise of the two components is independent, so they are used one after the other.
    for i in range(2):
        h0, h1 = H[i, 0], H[i, 1]
        a0, a1 = p00 * h0 + p01 * h1, p01 * h0 + p11 * h1  # P h
        S = h0 * a0 + h1 * a1 + r2
        k0, k1 = a0 / S, a1 / S
        innovation = velocity[i] - predicted[i] - h0 * (out_b[0] - b[0]) - h1 * (out_b[1] - b[1])
        out_b[0] += k0 * innovation
        out_b[1] += k1 * innovation
        # Joseph's form, P = (1 - k h) P (1 - k h)' + k r^2 k': stays symmetric and positive definite
        j00, j01, j10, j11 = 1.0 - k0 * h0, -k0 * h1, -k1 * h0, 1.0 - k1 * h1
        q00, q01 = j00 * p00 + j01 * p01, j00 * p01 + j01 * p11
        q10, q11 = j10 * p00 + j11 * p01, j10 * p01 + j11 * p11
        p00 = q00 * j00 + q01 * j01 + r2 * k0 * k0
        p01 = q00 * j10 + q01 * j11 + r2 * k0 * k1
        p11 = q10 * j10 + q11 * j11 + r2 * k1 * k1
    if not np.isfinite(out_b[0] + out_b[1]):
        return (*predicted, *belief)
    north, east = min(max(out_b[0], -max_mps), max_mps), min(max(out_b[1], -max_mps), max_mps)
    return predicted[0], predicted[1], north, east, p00, p01, p11


@jit_outlined
def _predicted_velocity(
    b: Array, until: int, vehicle: Array, measured: Measured, commands: Commands, profiles: tuple[Profile, Profile]
) -> tuple[float, float]:
    """Return h(b): the velocity over ground, north and east (m/s), with bias b (2,); other arguments as above."""
    (depth, north, east), later = profiles
    end = predict_state(vehicle, measured, until, commands, (depth, north + b[0], east + b[1]))
    before_north, before_east = current_at_depth(depth, north, east, end[11])
    current_north, current_east = current_at_depth(later[0], later[1], later[2], end[11])
    dn, de = current_north - before_north, current_east - before_east
    cos, sin = np.cos(end[4]), np.sin(end[4])
    p = coefficients(vehicle)
    # The change of the current with time carries the vehicle: M [u', v'] = ... - m R(psi)' c'
    u = end[2] - p.dry_mass / p.mass_surge * (cos * dn + sin * de)
    v = end[3] - p.dry_mass / p.mass_sway * (cos * de - sin * dn)
    # v = R(psi) [u, v] + c
    return cos * u - sin * v + current_north + b[0], sin * u + cos * v + current_east + b[1]


@jit
def propagate(belief: FlatBelief, interval_ns: int, noise: Noise) -> FlatBelief:
    """Return the belief after a random walk; its largest variance in any direction is bounded by the prior variance.

    Parameters
    ----------
    belief : before the walk.
    interval_ns : length of the walk (ns).
    noise : its walk and its prior.
    """
    north, east, p00, p01, p11 = belief
    growth = noise[0] * noise[0] * float(interval_ns) * 1e-9
    p00, p11 = p00 + growth, p11 + growth
    largest = 0.5 * (p00 + p11) + np.sqrt(0.25 * (p00 - p11) ** 2 + p01 * p01)
    bounded = min(1.0, noise[2] / largest)  # unobservable directions must not grow beyond the prior
    return north, east, bounded * p00, bounded * p01, bounded * p11


def _with_bias(estimate: Estimate, north: float, east: float) -> Estimate:
    """Return the estimate with a bias (m/s) added to its current profile, or to still water if it has none."""
    known = estimate.current or STILL_WATER
    current = msgspec.structs.replace(known, north_mps=known.north_mps + north, east_mps=known.east_mps + east)
    return msgspec.structs.replace(estimate, current=current)
