"""Prediction of the vehicle's state at the instant at which a plan takes effect: dead-time compensation.

An estimate is valid at its own time; the plan that is computed from it takes effect later. Until then the commands that
were sent before act, through the thrusters' lag. The delivered thrust follows the lag model through these commands:
from the last report of the actuators that is not newer than the estimate, and without reports from rest before the
first plan. Without newer estimates the prediction grows longer: ``mode.py`` says how long it is used.

The same flow is a nominal vehicle (``advance``): it moves exactly as the controller's model says.

The uncertainty of a prediction that no newer estimate corrects grows (``growth_m``):

    P(t) = A P0 A' + B Pb B' + sum over both lateral thrusters of d d',    growth = sd(t) - sd(0),
    sd = sqrt(P_nn + P_ee)

P0   covariance (6, 6) of the estimate; zero if it has none
A    derivative (2, 6) of the predicted position by the estimate
Pb   covariance (2, 2) of the mean current since the estimate: of the estimated bias with its random walk, and of the
     estimate's profile if it has standard deviations
B    derivative (2, 2) of the predicted position by the current
d    change (2,) of the predicted position if a thruster delivers 10 % more

The derivatives are differences of predictions, so this takes eleven predictions. The controller needs them only while
its estimates are late (``mode.py``).
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple, TypeAlias

import msgspec
import numpy as np

from ltv_mpc.control.sent_commands import Commands, SentCommands
from ltv_mpc.conversion import exact
from ltv_mpc.jit import copy_to, count_up_to, jit, linear_at
from ltv_mpc.messages import Applied, Array, CurrentProfile, Estimate, Pair, Plan, Triple
from ltv_mpc.vehicle.dynamics import coefficients
from ltv_mpc.vehicle.flow import STATES, advance_heave, advance_stage, lag_table, lag_weights
from ltv_mpc.vehicle.parameters import Vehicle

STEP_NS = 100_000_000
"""Longest integration step; steps also end where the commands have a knot."""

MAX_REPORTS = 32
"""Number of reports of the actuators that are kept for later estimates: a delay of 2 s or more at 10 Hz and one a plan.
The one before the estimate in use is kept beside them.
"""

NO_PROFILE = CurrentProfile(depth_m=np.empty(0), north_mps=np.empty(0), east_mps=np.empty(0))


class Start(NamedTuple):
    """State of the vehicle at the instant at which the plan takes effect."""

    t_ns: int
    # (10,) n, e, u, v, psi, r, F1, F2, and the commands of port and starboard in force; thrusts are those delivered
    lateral: Array
    vertical_command_N: float  # in force
    depth_m: float
    sinking_mps: float
    vertical_N: float  # delivered
    current_north_mps: float
    current_east_mps: float

    @property
    def X(self) -> Array:
        """State (8,): n, e, u, v, psi, r, F1, F2."""
        return self.lateral[:STATES]

    @property
    def thrust_N(self) -> Triple:
        """Delivered thrust of port, starboard and vertical (N)."""
        port, starboard = self.lateral[6:STATES].tolist()
        return port, starboard, self.vertical_N

    @property
    def command(self) -> Array:
        """Commands (3,) of port, starboard and vertical in force (N)."""
        return np.array([*self.lateral[STATES:], self.vertical_command_N])


class Report(NamedTuple):
    """Delivered thrust at one time, as the actuators reported it."""

    t_ns: int
    thrust_N: Array  # (3,) port, starboard, vertical


Measured: TypeAlias = tuple[int, Array, int, Array]
"""Where a prediction begins: time of the estimate (ns); estimate (8,) n, e (m), psi (rad), r (rad/s), n', e' over
ground (m/s), depth (m, NaN: none), sinking speed (m/s); time of the report (ns), its thrusts (3,) (N).
"""

Profile: TypeAlias = tuple[Array, Array, Array]
"""Current over depth: depths (K,) in increasing order (m), north and east (K,) (m/s). Linear between the depths,
constant beyond; no current if K is 0.
"""


def currents_at_depths(profile: CurrentProfile | None, depth_m: Array) -> Array:
    """Return the current at several depths.

    Parameters
    ----------
    profile : linear between its depths, constant beyond; None: no current.
    depth_m : (M,) depths (m).

    Returns
    -------
    (M, 2) current, north and east (m/s).
    """
    if profile is None:
        return np.zeros((len(depth_m), 2))
    currents = np.empty((len(depth_m), 2))
    currents[:, 0] = np.interp(depth_m, profile.depth_m, profile.north_mps)
    currents[:, 1] = np.interp(depth_m, profile.depth_m, profile.east_mps)
    return currents


class Prediction:
    """Prediction of the vehicle's state, from an estimate through the commands that were sent."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Begin without a report of the actuators."""
        self.coefficients = np.array(vehicle.coefficients())
        """(21,) coefficients of the vehicle."""
        self._shares = np.ones(3)  # of their reported thrust that the thrusters deliver
        self._report: Report | None = None  # the newest that is not newer than the estimate in use
        self._later_reports: deque[Report] = deque(maxlen=MAX_REPORTS)

    def set_shares(self, shares: Pair) -> None:
        """Predict with lateral thrusters that deliver a share of their reported thrust.

        Parameters
        ----------
        shares : of port and starboard; 1 if sound.
        """
        self._shares[:2] = shares

    def add_report(self, applied: Applied) -> None:
        """Take in the thrusts that the actuators deliver.

        Parameters
        ----------
        applied : report; one that is not newer than the last is ignored.
        """
        newest = self._later_reports[-1] if self._later_reports else self._report
        if newest is None or applied.t_ns > newest.t_ns:
            self._later_reports.append(Report(applied.t_ns, np.array(applied.thrust_N)))

    def state_at(self, estimate: Estimate, t_ns: int, commands: SentCommands) -> Start:
        """Return the predicted state of the vehicle.

        Parameters
        ----------
        estimate : where the prediction begins; its current profile is used.
        t_ns : time of the state, vehicle time (ns); at least the estimate's own time is taken.
        commands : commands in force from the estimate's time on.
        """
        t_ns = max(t_ns, estimate.t_ns)
        profile = profile_of(estimate)
        end = predict_state(
            self.coefficients,
            self.measured(estimate, commands),
            t_ns,
            self.delivered(commands),
            (profile.depth_m, profile.north_mps, profile.east_mps),
        )
        return Start(t_ns, end[:10], *end[10:].tolist())

    def measured(self, estimate: Estimate, commands: SentCommands) -> Measured:
        """Return the inputs of ``predict_state`` that belong to one estimate.

        Parameters
        ----------
        estimate : not older than that of the last call. The newest report of the actuators that is not newer than it
            belongs to it.
        commands : commands in force. Without such a report the thrusters are taken to have delivered the first of them.
        """
        while self._later_reports and self._later_reports[0].t_ns <= estimate.t_ns:
            self._report = self._later_reports.popleft()
        report = self._report
        if report is None or report.t_ns > estimate.t_ns:
            report = Report(*commands.oldest)
        flat = np.array(
            (
                estimate.north_m,
                estimate.east_m,
                estimate.heading_rad,
                estimate.yaw_rate_radps,
                estimate.velocity_north_mps,
                estimate.velocity_east_mps,
                math.nan if estimate.depth_m is None else estimate.depth_m,
                estimate.velocity_down_mps or 0.0,
            )
        )
        return estimate.t_ns, flat, report.t_ns, report.thrust_N * self._shares

    def delivered(self, commands: SentCommands) -> Commands:
        """Return the commands times the share of them that each thruster delivers.

        Parameters
        ----------
        commands : as sent.
        """
        t, thrust = commands.knots
        return t, thrust * self._shares


def profile_of(estimate: Estimate) -> CurrentProfile:
    """Return the estimate's current profile; one without depths, which means no current, if it has none."""
    return NO_PROFILE if estimate.current is None else estimate.current


@jit
def current_at_depth(depth: Array, north: Array, east: Array, z: float) -> tuple[float, float]:
    """Return the current at one depth: linear between the profile's depths, constant beyond, zero without a profile.

    Parameters
    ----------
    depth, north, east : (K,) profile (m, m/s), by increasing depth.
    z : depth (m).

    Returns
    -------
    North and east current (m/s).
    """
    return linear_at(depth, north, z), linear_at(depth, east, z)


@jit
def _delivered(since: int, F: Array, until: int, commands: Commands, lags: tuple[float, float, float]) -> Array:
    """Return the delivered thrusts (3,) at ``until``, from F (3,) at ``since``, by the commands and the lags (s)."""
    t, thrust = commands
    out = F.copy()
    k = count_up_to(t, since)
    while since < until:
        end = min(t[k], until) if k < len(t) else until
        h = float(end - since) * 1e-9
        for i in range(3):
            a, b0, b1 = lag_weights(h, h, lags[i])
            out[i] = a * out[i] + b0 * linear_at(t, thrust[:, i], since) + b1 * linear_at(t, thrust[:, i], end)
        since = end
        k += 1
    return out


@jit
def predict_state(vehicle: Array, measured: Measured, until: int, commands: Commands, profile: Profile) -> Array:
    """Return the predicted state of the vehicle at a time, by the exact flow of the nominal model.

    Parameters
    ----------
    vehicle : (21,) coefficients of the vehicle.
    measured, commands, profile : as their types say. They are plain tuples: a call from Python with named ones takes
        2 us longer (docs/notes/kernel-arguments.md).
    until : time of the state (ns), not before the estimate's.

    Returns
    -------
    (16,) n, e, u, v, psi, r, F1, F2; commands of port and starboard, command of the vertical thruster (N), depth (m),
    sinking speed (m/s), delivered vertical thrust (N), current north and east (m/s).
    """
    p = coefficients(vehicle)
    lags = (p.lag_port, p.lag_starboard, p.lag_vertical)
    since, estimate, report_t_ns, reported_N = measured
    t, thrust = commands
    depth, north, east = profile
    out = np.empty(16)
    F = _delivered(report_t_ns, reported_N, since, commands, lags)
    has_depth = not np.isnan(estimate[6])
    z, w, F3 = (estimate[6] if has_depth else 0.0), estimate[7], F[2]
    c0, c1, u0, u1 = np.empty(2), np.empty(2), np.empty(2), np.empty(2)
    c0[0], c0[1] = current_at_depth(depth, north, east, z)
    # [u, v] = R(psi)' (velocity over ground - current)
    cos, sin = np.cos(estimate[2]), np.sin(estimate[2])
    vn, ve = estimate[4] - c0[0], estimate[5] - c0[1]
    X = out[:STATES]
    X[0], X[1], X[2], X[3] = estimate[0], estimate[1], cos * vn + sin * ve, cos * ve - sin * vn
    X[4], X[5], X[6], X[7] = estimate[2], estimate[3], F[0], F[1]
    knot = count_up_to(t, since)
    while since < until:
        end = min(t[knot], until) if knot < len(t) else until
        pieces = max(1, -(-(end - since) // STEP_NS))
        begin, way = since, end - since
        for i in range(pieces):
            at = begin + way * (i + 1) // pieces
            h = float(at - since) * 1e-9
            if has_depth:  # heave does not depend on the other states, and gives the current along the way
                w0, w1 = linear_at(t, thrust[:, 2], since), linear_at(t, thrust[:, 2], at)
                z, w, F3 = advance_heave(z, w, F3, w0, w1, h, p)
                if z <= 0.0:  # the surface
                    z, w = 0.0, max(w, 0.0)
            c1[0], c1[1] = current_at_depth(depth, north, east, z)
            for j in range(2):
                u0[j], u1[j] = linear_at(t, thrust[:, j], since), linear_at(t, thrust[:, j], at)
            advance_stage(X.copy(), u0, u1, c0, c1, h, p, lag_table(h, p), X)
            copy_to(c0, c1)
            since = at
        knot += 1
    for j in range(3):
        out[STATES + j] = linear_at(t, thrust[:, j], until)
    out[11], out[12], out[13], out[14], out[15] = z, w, F3, c0[0], c0[1]
    return out


def advance(vehicle: Vehicle, estimate: Estimate, plan: Plan, *, duration_s: float) -> Estimate:
    """Return the estimate some time later under a plan, by the exact flow of the nominal model.

    Before the plan's start its first thrusts act; after its end they ramp to zero at the slew limit. An ``Estimate``
    does not hold the delivered thrust: at the beginning every thruster is taken to deliver its command.

    Parameters
    ----------
    vehicle : nominal model.
    estimate : state at the beginning.
    plan : commands that act.
    duration_s : time to advance (s).
    """
    vehicle, estimate = exact(vehicle), exact(estimate)
    commands = SentCommands(vehicle)
    commands.add(plan, before_N=plan.initial_thrust_N)
    end = Prediction(vehicle).state_at(estimate, estimate.t_ns + round(duration_s * 1e9), commands)
    return as_estimate(end, estimate)


def as_estimate(end: Start, before: Estimate) -> Estimate:
    """Return a predicted state as an estimate: [n', e'] = R(psi) [u, v] + c.

    Parameters
    ----------
    end : predicted state.
    before : estimate from which it was predicted; current, covariance and the missing depth are taken over.
    """
    n, e, u, v, psi, r = (float(x) for x in end.X[:6])
    has_depth = before.depth_m is not None
    altitude = before.altitude_m
    if altitude is not None and before.depth_m is not None:
        altitude = max(altitude + before.depth_m - end.depth_m, 0.0)  # over a level bottom
    c = currents_at_depths(before.current, np.array([end.depth_m]))[0]
    cos, sin = np.cos(psi), np.sin(psi)
    return msgspec.structs.replace(
        before,
        t_ns=end.t_ns,
        north_m=n,
        east_m=e,
        depth_m=end.depth_m if has_depth else None,
        heading_rad=float(np.arctan2(sin, cos)),
        yaw_rate_radps=r,
        velocity_north_mps=float(cos * u - sin * v + c[0]),
        velocity_east_mps=float(sin * u + cos * v + c[1]),
        velocity_down_mps=end.sinking_mps if has_depth else None,
        altitude_m=altitude,
    )


STEP = 1e-3
"""Step of the differences in m, m/s, rad and rad/s."""

THRUST_SD = 0.1
"""Standard deviation of the delivered thrust, as a share of it."""

COLUMN_OF = (0, 1, 4, 5, 2, 3)
"""Place of north, east, velocity north and east, heading, yaw rate in the estimate of ``prediction.Measured``."""


def growth_m(
    prediction: Prediction, estimate: Estimate, t_ns: int, commands: SentCommands, bias_covariance: Array
) -> float:
    """Return the growth of the standard deviation of the predicted horizontal position (m).

    Parameters
    ----------
    prediction : knows the vehicle and the actuators' reports.
    estimate : where the prediction begins, with the bias in its current.
    t_ns : time of the predicted position, vehicle time (ns).
    commands : commands in force from the estimate's time on.
    bias_covariance : (2, 2) of the mean since the estimate of the bias of its current (m2/s2).
    """
    since_ns, state, report_ns, thrust_N = prediction.measured(estimate, commands)
    times, commanded_N = prediction.delivered(commands)
    profile = profile_of(estimate)

    def _position(state: Array = state, current: tuple[float, float] = (0.0, 0.0), gain: Array | float = 1.0) -> Array:
        return predict_state(
            prediction.coefficients,
            (since_ns, state, report_ns, thrust_N * gain),
            max(t_ns, since_ns),
            (times, commanded_N * gain),
            (profile.depth_m, profile.north_mps + current[0], profile.east_mps + current[1]),
        )[:2]

    at = _position()
    variance = 0.0
    for thruster in (0, 1):
        gain = np.ones(3)
        gain[thruster] += THRUST_SD
        d = _position(gain=gain) - at
        variance += float(d @ d)
    Pb = _current_variance(profile, estimate.depth_m) * np.eye(2) + bias_covariance
    if Pb.any():
        B = np.array([_position(current=(STEP, 0.0)) - at, _position(current=(0.0, STEP)) - at]).T / STEP
        variance += float(np.trace(B @ Pb @ B.T))
    P0 = estimate.covariance
    if P0 is None:
        return math.sqrt(variance)
    A = np.array([_position(state + STEP * np.eye(len(state))[column]) - at for column in COLUMN_OF]).T / STEP
    variance += float(np.trace(A @ P0 @ A.T))
    return math.sqrt(variance) - math.sqrt(float(P0[0, 0] + P0[1, 1]))


def _current_variance(profile: CurrentProfile, depth_m: float | None) -> float:
    """Return the variance of either component of a profile at a depth (m^2/s^2); 0 if it is not known."""
    if profile.sd_mps is None:
        return 0.0
    sd_mps, _ = current_at_depth(profile.depth_m, profile.sd_mps, profile.sd_mps, depth_m or 0.0)
    return sd_mps * sd_mps
