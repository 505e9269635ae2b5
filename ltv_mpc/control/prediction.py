"""Prediction of the vehicle's state at the instant at which a plan takes effect: dead-time compensation.

An estimate is valid at its own time; the plan that is computed from it takes effect later. Until then the commands that
were sent before act, through the thrusters' lag. The delivered thrust follows the lag model through these commands:
from the last report of the actuators that is not newer than the estimate, and without reports from rest before the
first plan. Without newer estimates the prediction grows longer: ``mode.py`` says how long it is used.

The commands in force by time are everything that was sent, as one piecewise linear function (``SentCommands``). A plan
takes over from the one before at its own start. After its end the commands ramp to rest at the slew limit, as
the actuators do without a new plan (``plan_gate.py``): the lateral ones to zero, the vertical one to
``failsafe_vertical_N``. The prediction of the state at the start of a new plan uses these commands. The actuators may
report another command (a plan came late, or this controller is new): then the report is taken as true, and from there
the commands approach the plan at the slew limit.

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

import numpy as np

from ltv_mpc.jit import copy_to, count_up_to, jit, linear_at
from ltv_mpc.messages import Applied, Array, CurrentProfile, Estimate, Pair, Plan, Times, Triple
from ltv_mpc.safety.health import plan_end_ns
from ltv_mpc.vehicle.dynamics import coefficients
from ltv_mpc.vehicle.flow import STATES, advance_heave, advance_stage, lag_table, lag_weights
from ltv_mpc.vehicle.parameters import Vehicle

HISTORY_NS, HISTORY_LAGS = 10_000_000_000, 8.0
"""Shortest history while estimates arrive, in ns and in lags of a thruster. Without reports the delivered thrust
follows from it, and e^-8 of an error at its begin is left.
"""

MAX_HISTORY_NS = 60_000_000_000
"""Length of the history while they do not: it reaches back to the estimate in use, at most this far."""

BEFORE_ESTIMATE_NS = 1_000_000_000
"""Time before the estimate in use from which commands are kept: a report of the actuators may be older than it."""

TOLERANCE_N = 0.01
"""Largest difference between two commands that counts as rounding."""

CATCH_UP_STEP_NS = 10_000_000
"""Time step in which the reported command approaches the plan."""


Commands: TypeAlias = tuple[Times, Array]
"""Commands by time: knots (M,), vehicle time (ns); thrusts (M, 3) of port, starboard and vertical (N). They are linear
between the knots, constant beyond them, and zero if there are no knots.
"""


class SentCommands:
    """Commands that the actuators follow, by time."""

    def __init__(self, vehicle: Vehicle, period_ns: int = 0) -> None:
        """Begin before the first plan.

        Parameters
        ----------
        vehicle : its slew limits, its failsafe thrust and its ``plan_timeout_s`` are used.
        period_ns : period of the plans (ns).
        """
        self._slew = np.array([t.slew_N_per_s for t in vehicle.thrusters])
        self._rest = np.array([0.0, 0.0, vehicle.failsafe_vertical_N])
        self._history_ns = max(HISTORY_NS, round(HISTORY_LAGS * 1e9 * max(t.lag_s for t in vehicle.thrusters)))
        self._period_ns, self._timeout_s = period_ns, vehicle.plan_timeout_s
        self.knots: Commands = (np.empty(0, dtype=np.int64), np.empty((0, 3)))
        """Commands from ``HISTORY_NS`` ago on, or from the estimate of the last plan on if that is older."""

    def add(self, plan: Plan, *, before_N: Triple = (0.0, 0.0, 0.0)) -> None:
        """Add a plan that was sent.

        Parameters
        ----------
        plan : is in force from its first knot on.
        before_N : commands until then, if it is the first plan (N); by default the thrusters are at rest.
        """
        (t, thrust), start_ns = self.knots, int(plan.t_ns[0])
        if len(t) == 0:
            t, thrust = np.array([start_ns - 1]), np.array([before_N])
        estimate_ns = max(plan.estimate_t_ns - BEFORE_ESTIMATE_NS, start_ns - MAX_HISTORY_NS)
        past = slice(t.searchsorted(min(start_ns - self._history_ns, estimate_ns), "right"), t.searchsorted(start_ns))
        end_ns = plan_end_ns(plan.t_ns, self._period_ns, self._timeout_s)
        k = int(plan.t_ns.searchsorted(end_ns))
        last_N, before_ns = plan.thrust_N[k], int(plan.t_ns[k - 1])
        if k > 0:
            part = (end_ns - before_ns) / (int(plan.t_ns[k]) - before_ns)
            last_N = plan.thrust_N[k - 1] + part * (last_N - plan.thrust_N[k - 1])
        # One knot where each thruster comes to rest, in the order of time; two in one nanosecond share it.
        way_N = last_N - self._rest
        own_ns = np.ceil(np.abs(way_N) / self._slew * 1e9)
        ramp_ns = np.array(sorted({0.0, *own_ns.tolist()}))
        left = 1.0 - np.minimum(ramp_ns[:, None] / np.maximum(own_ns, 1.0), 1.0)
        self.knots = (
            np.concatenate([t[past], plan.t_ns[:k], end_ns + ramp_ns.astype(np.int64)]),
            np.concatenate([thrust[past], plan.thrust_N[:k], self._rest + left * way_N]),
        )

    @property
    def oldest(self) -> tuple[int, Array]:
        """Time (ns) and commands (3,) of the oldest knot (N); zero if nothing was sent."""
        t, thrust = self.knots
        return (int(t[0]), thrust[0]) if len(t) else (0, np.zeros(3))

    def correct(self, t_ns: int, command_N: Triple) -> None:
        """Correct the commands by a report of the actuators.

        Parameters
        ----------
        t_ns : time of the report, vehicle time (ns).
        command_N : commands of port, starboard and vertical in force at ``t_ns`` (N).
        """
        t, thrust = self.knots
        times, commands = [t_ns], [np.array(command_N)]
        target = self.at(np.array(times, dtype=np.int64))[0]
        if np.abs(target - commands[0]).max() <= TOLERANCE_N:
            return
        while np.abs(target - commands[-1]).max() > TOLERANCE_N and times[-1] < t_ns + HISTORY_NS:
            times.append(times[-1] + CATCH_UP_STEP_NS)
            target = self.at(np.array(times[-1:], dtype=np.int64))[0]
            reach = self._slew * CATCH_UP_STEP_NS * 1e-9
            commands.append(commands[-1] + np.clip(target - commands[-1], -reach, reach))
        before, after = t < t_ns, t > times[-1]
        self.knots = (
            np.concatenate([t[before], np.array(times, dtype=np.int64), t[after]]),
            np.concatenate([thrust[before], np.array(commands), thrust[after]]),
        )

    def at(self, t_ns: Times) -> Array:
        """Return the commands in force.

        Parameters
        ----------
        t_ns : (M,) vehicle times (ns).

        Returns
        -------
        (M, 3) commands of port, starboard and vertical (N); zero if nothing was sent.
        """
        t, thrust = self.knots
        if not len(t):
            return np.zeros((len(t_ns), 3))
        at, knots = t_ns - t[0], t - t[0]
        return np.array([np.interp(at, knots, of_one) for of_one in thrust.T]).T


STEP_NS = 100_000_000
"""Longest integration step; steps also end where the commands have a knot."""

MAX_REPORTS = 32
"""Number of reports of the actuators that are kept for later estimates: a delay of 2 s or more at 10 Hz and one a plan.
The one before the estimate in use is kept beside them.
"""

STILL_WATER = CurrentProfile(depth_m=np.zeros(1), north_mps=np.zeros(1), east_mps=np.zeros(1))
"""Profile of an estimate that has none."""


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
constant beyond.
"""


def profile_of(current: CurrentProfile | None) -> Profile:
    """Return the arrays of an estimate's profile; those of still water if it has none."""
    known = current or STILL_WATER
    return known.depth_m, known.north_mps, known.east_mps


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
    depth, north, east = profile_of(profile)
    return np.column_stack([np.interp(depth_m, depth, north), np.interp(depth_m, depth, east)])


class Prediction:
    """Prediction of the vehicle's state, from an estimate through the commands that were sent."""

    def __init__(self, vehicle: Vehicle, period_ns: int = 0) -> None:
        """Begin without a plan and without a report of the actuators.

        Parameters
        ----------
        vehicle, period_ns : as ``SentCommands`` takes them.
        """
        self.sent = SentCommands(vehicle, period_ns)
        """Commands in force, by time."""
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

    def state_at(self, estimate: Estimate, t_ns: int) -> Start:
        """Return the predicted state of the vehicle.

        Parameters
        ----------
        estimate : where the prediction begins; its current profile is used.
        t_ns : time of the state, vehicle time (ns); at least the estimate's own time is taken.
        """
        t_ns = max(t_ns, estimate.t_ns)
        profile = profile_of(estimate.current)
        end = predict_state(self.coefficients, self.measured(estimate), t_ns, self.delivered, profile)
        return Start(t_ns, end[:10], *end[10:].tolist())

    def measured(self, estimate: Estimate) -> Measured:
        """Return the inputs of ``predict_state`` that belong to one estimate.

        Parameters
        ----------
        estimate : not older than that of the last call. The newest report of the actuators that is not newer than it
            belongs to it. Without one the thrusters are taken to have delivered the first of the commands.
        """
        while self._later_reports and self._later_reports[0].t_ns <= estimate.t_ns:
            self._report = self._later_reports.popleft()
        report = self._report
        if report is None or report.t_ns > estimate.t_ns:
            report = Report(*self.sent.oldest)
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

    @property
    def delivered(self) -> Commands:
        """Commands times the share of them that each thruster delivers."""
        t, thrust = self.sent.knots
        return t, thrust * self._shares


@jit
def current_at_depth(depth: Array, north: Array, east: Array, z: float) -> tuple[float, float]:
    """Return the current at one depth: linear between the profile's depths, constant beyond.

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


STEP = 1e-3
"""Step of the differences in m, m/s, rad and rad/s."""

THRUST_SD = 0.1
"""Standard deviation of the delivered thrust, as a share of it."""

COLUMN_OF = (0, 1, 4, 5, 2, 3)
"""Place of north, east, velocity north and east, heading, yaw rate in the estimate of ``prediction.Measured``."""


def growth_m(prediction: Prediction, estimate: Estimate, t_ns: int, bias_covariance: Array) -> float:
    """Return the growth of the standard deviation of the predicted horizontal position (m).

    Parameters
    ----------
    prediction : knows the vehicle, the commands in force and the actuators' reports.
    estimate : where the prediction begins, with the bias in its current.
    t_ns : time of the predicted position, vehicle time (ns).
    bias_covariance : (2, 2) of the mean since the estimate of the bias of its current (m2/s2).
    """
    since_ns, state, report_ns, thrust_N = prediction.measured(estimate)
    times, commanded_N = prediction.delivered
    depth, north, east = profile_of(estimate.current)

    def _position(state: Array = state, current: tuple[float, float] = (0.0, 0.0), gain: Array | float = 1.0) -> Array:
        return predict_state(
            prediction.coefficients,
            (since_ns, state, report_ns, thrust_N * gain),
            max(t_ns, since_ns),
            (times, commanded_N * gain),
            (depth, north + current[0], east + current[1]),
        )[:2]

    at = _position()
    variance = 0.0
    for thruster in (0, 1):
        gain = np.ones(3)
        gain[thruster] += THRUST_SD
        d = _position(gain=gain) - at
        variance += float(d @ d)
    Pb = _current_variance(estimate) * np.eye(2) + bias_covariance
    if Pb.any():
        B = np.array([_position(current=(STEP, 0.0)) - at, _position(current=(0.0, STEP)) - at]).T / STEP
        variance += float(np.trace(B @ Pb @ B.T))
    P0 = estimate.covariance
    if P0 is None:
        return math.sqrt(variance)
    A = np.array([_position(state + STEP * np.eye(len(state))[column]) - at for column in COLUMN_OF]).T / STEP
    variance += float(np.trace(A @ P0 @ A.T))
    return math.sqrt(variance) - math.sqrt(float(P0[0, 0] + P0[1, 1]))


def _current_variance(estimate: Estimate) -> float:
    """Return the variance of either component of the profile at the vehicle (m^2/s^2); 0 if it is not known."""
    profile = estimate.current
    if profile is None or profile.sd_mps is None:
        return 0.0
    sd_mps, _ = current_at_depth(profile.depth_m, profile.sd_mps, profile.sd_mps, estimate.depth_m or 0.0)
    return sd_mps * sd_mps
