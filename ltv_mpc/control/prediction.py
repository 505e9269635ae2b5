"""Prediction of the vehicle's state at the instant at which a plan takes effect: dead-time compensation.

An estimate is valid at its own time; the plan that is computed from it takes effect later. Until then the commands that
were sent before act, through the thrusters' lag. The delivered thrust follows the lag model through these commands:
from the last report of the actuators that is not newer than the estimate, and without reports from rest before the
first plan. Without newer estimates the prediction grows longer: ``mode.py`` says how long it is used.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple, TypeAlias

import numpy as np

from ltv_mpc.control.sent_commands import Commands, SentCommands
from ltv_mpc.jit import copy_to, count_up_to, jit, linear_at
from ltv_mpc.messages import Applied, Array, CurrentProfile, Estimate, Pair, Triple
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
