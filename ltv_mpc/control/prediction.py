"""From the newest estimate to the instant at which the plan will take effect: dead time compensated.

The estimate is valid at its own time; the plan that is being computed takes effect later. Until then the commands that
were already sent act, through the thrusters' lag. The delivered thrust is followed by the lag model, corrected by what
the actuators report.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from ltv_mpc.control.sent_commands import SentCommands, command_at
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Applied, Array, CurrentProfile, Estimate, Times
from ltv_mpc.vehicle.dynamics import coefficients
from ltv_mpc.vehicle.flow import STATES, advance_heave, advance_stage, lag_weights
from ltv_mpc.vehicle.parameters import Vehicle

STEP_NS = 100_000_000
"""Longest piece of the roll; pieces end where the commands have a knot."""

REPORTS = 32
"""Reports of the actuators that are kept: 3 s at 10 Hz, more than any estimate is late."""


NEVER = -(2**62)
"""The time of a report that there is not."""

NO_PROFILE = CurrentProfile(depth_m=np.empty(0), north_mps=np.empty(0), east_mps=np.empty(0))


class Start(NamedTuple):
    """The vehicle at the instant at which the plan takes effect."""

    t_ns: int
    lateral: Array  # (10,) n, e, u, v, psi, r, F1, F2, and the commands of port and starboard in force
    vertical_command_N: float
    depth_m: float
    sinking_mps: float
    vertical_N: float  # delivered

    @property
    def X(self) -> Array:
        """(8,) n, e, u, v, psi, r, F1, F2."""
        return self.lateral[:STATES]

    @property
    def command(self) -> Array:
        """(3,) in force."""
        return np.array([*self.lateral[STATES:], self.vertical_command_N])


def currents_at_depths(profile: CurrentProfile | None, depth_m: Array) -> Array:
    """North and east current (M, 2) at depths (M,): linear between the profile's depths, constant beyond; else zero."""
    if profile is None:
        return np.zeros((len(depth_m), 2))
    return np.stack(
        [np.interp(depth_m, profile.depth_m, profile.north_mps), np.interp(depth_m, profile.depth_m, profile.east_mps)],
        axis=1,
    )


class Prediction:
    """Rolls estimates forward through the commands sent."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = np.array(vehicle.coefficients())
        self._reports: deque[tuple[int, Array]] = deque(maxlen=REPORTS)
        self._nothing = np.zeros(3)

    def add_report(self, applied: Applied) -> None:
        """The actuators say what they deliver."""
        if not self._reports or applied.t_ns > self._reports[-1][0]:
            self._reports.append((applied.t_ns, np.array(applied.thrust_N)))

    def state_at(self, estimate: Estimate, t_ns: int, commands: SentCommands) -> Start:
        """The vehicle at ``t_ns``, not before the estimate's own time."""
        t_ns = max(t_ns, estimate.t_ns)
        vehicle, flat, report_ns, report = self.before(estimate)
        profile = profile_of(estimate)
        start = predict_state(
            vehicle,
            flat,
            estimate.t_ns,
            t_ns,
            *commands.knots,
            report_ns,
            report,
            profile.depth_m,
            profile.north_mps,
            profile.east_mps,
        )
        return Start(t_ns, start[:10], *start[10:].tolist())

    def before(self, estimate: Estimate) -> tuple[Array, Array, int, Array]:
        """Inputs of ``predict_state``: vehicle (19,), estimate (8,), time of the last report, its thrust (3,)."""
        report_ns, report = NEVER, self._nothing
        for at, thrust in reversed(self._reports):
            if at <= estimate.t_ns:
                report_ns, report = at, thrust
                break
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
        return self._vehicle, flat, report_ns, report


def profile_of(estimate: Estimate) -> CurrentProfile:
    """The estimate's current; one without depths, which is none, where it has none."""
    return NO_PROFILE if estimate.current is None else estimate.current


@jit
def current_at_depth(depth: Array, north: Array, east: Array, z: float) -> tuple[float, float]:
    """North and east current at depth z: linear between the profile's depths, constant beyond; zero without one."""
    if len(depth) == 0:
        return 0.0, 0.0
    k = np.searchsorted(depth, z, side="right")
    if k == 0:
        return north[0], east[0]
    if k == len(depth):
        return north[k - 1], east[k - 1]
    part = (z - depth[k - 1]) / (depth[k] - depth[k - 1])
    return north[k - 1] + part * (north[k] - north[k - 1]), east[k - 1] + part * (east[k] - east[k - 1])


@jit
def _delivered(since: int, F: Array, until: int, t: Times, thrust: Array, lags: tuple[float, float, float]) -> Array:
    """Thrust delivered (3,) at ``until``, from F (3,) at ``since``, through the commands sent and the lag."""
    out = F.copy()
    k = np.searchsorted(t, since, side="right")
    while since < until:
        end = min(t[k], until) if k < len(t) else until
        h = float(end - since) * 1e-9
        for i in range(3):
            a, b0, b1 = lag_weights(h, h, lags[i])
            out[i] = a * out[i] + b0 * command_at(t, thrust, since, i) + b1 * command_at(t, thrust, end, i)
        since = end
        k += 1
    return out


@jit
def predict_state(
    vehicle: Array,
    estimate: Array,
    since: int,
    until: int,
    t: Times,
    thrust: Array,
    report_ns: int,
    report: Array,
    depth: Array,
    north: Array,
    east: Array,
) -> Array:
    """State X (8,), commands of port and starboard, then vertical command, depth, sinking speed, vertical thrust (14,).

    ``vehicle`` (19,) its coefficients; ``estimate`` (8,): north, east, heading, yaw rate, velocity north and east over
    ground, depth (NaN: none), sinking speed, valid at ``since``; commands by t (M,), thrust (M, 3); ``report`` (3,)
    what was delivered at ``report_ns``.
    """
    p = coefficients(vehicle)
    lags = (p.lag_port, p.lag_starboard, p.lag_vertical)
    out = np.empty(14)
    if report_ns == NEVER:
        F = np.array([command_at(t, thrust, since, i) for i in range(3)])
    else:
        F = _delivered(report_ns, report, since, t, thrust, lags)
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
    knot = np.searchsorted(t, since, side="right")
    while since < until:
        end = min(t[knot], until) if knot < len(t) else until
        pieces = max(1, -(-(end - since) // STEP_NS))
        begin, way = since, end - since
        for i in range(pieces):
            at = begin + way * (i + 1) // pieces
            h = float(at - since) * 1e-9
            if has_depth:  # it does not depend on the rest, and gives the current on the way
                w0, w1 = command_at(t, thrust, since, 2), command_at(t, thrust, at, 2)
                z, w, F3 = advance_heave(z, w, F3, w0, w1, h, p)
                if z <= 0.0:  # the surface
                    z, w = 0.0, max(w, 0.0)
            c1[0], c1[1] = current_at_depth(depth, north, east, z)
            for j in range(2):
                u0[j], u1[j] = command_at(t, thrust, since, j), command_at(t, thrust, at, j)
            advance_stage(X.copy(), u0, u1, c0, c1, h, p, X)
            copy_to(c0, c1)
            since = at
        knot += 1
    for j in range(3):
        out[STATES + j] = command_at(t, thrust, until, j)
    out[11], out[12], out[13] = z, w, F3
    return out


@jit
def fill_currents(depth: Array, north: Array, east: Array, at: Array, C: Array) -> None:
    """Evaluate the current at depths ``at`` (N+1,) into C (N+1, 2)."""
    for k in range(len(at)):
        C[k, 0], C[k, 1] = current_at_depth(depth, north, east, at[k])
