"""Stamp check: whether the estimates are older than their stamps say.

A navigation that stamps its estimates when they arrive gives a state of the time t - d with the stamp t. The motion then
follows the thrusts d later than it should, whatever masses, drag and arms are. From one estimate to the next

    [du, dr] = theta' phi(d) + e,    phi(d) = [dI_1(d), dI_2(d), u dt, |u| u dt, r dt, |r| r dt, u v dt, v r dt, dt,
                                               d cos psi, d sin psi]

    dI_i(d)     impulse of the reported thrust of port and starboard over the interval, d seconds before
    theta       unknown (11, 2): what thrust, drag, Coriolis and Munk forces, wind and an unknown current do

Least squares with forgetting give for each delay d of ``DELAYS_S`` the theta that explains the motion best, and the sum
of the squares s_j(d) that it leaves in surge and yaw. Among N intervals with noise of unknown size

    J(d) = N/2 sum over j of log(s_j(d) + N ``NOISE``^2)                                         nats

is the negative log-likelihood. The delay is that of the least J, between the steps by a parabola. It counts with
``EVIDENCE_NATS`` more than a delay of at most one step, and above ``MIN_DELAY_S``. So a wrong vehicle file is no delay,
and thrusters that answer late are none if their reports say what they deliver. Without reports nothing is checked.
Source  Ljung 1999, System identification, section 7.4 (concentrated likelihood), section 11.2 (forgetting).
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.control.prediction import currents_at_depths
from ltv_mpc.messages import Applied, Array, CurrentProfile, Estimate
from ltv_mpc.references.limits import path_limits
from ltv_mpc.safety.thrust_impulse import ThrustImpulse
from ltv_mpc.vehicle.parameters import Vehicle

STEP_S = 0.1
DELAYS_S = STEP_S * np.arange(16)
"""Delays that are compared (s)."""

MIN_DELAY_S, EVIDENCE_NATS = 0.15, 10.0
"""Least delay that is named, and its evidence. Right stamps gave 8.5 nats at most: docs/notes/late-stamps.md."""

MEMORY_S, MIN_INTERVALS = 90.0, 60.0
"""Time in which an interval is forgotten to e^-1, and the number of intervals from which eleven unknowns are known."""

NOISE = 2e-3
"""Noise of a change of velocity over the top speed, and of a change of yaw rate over the rate of full thrust."""

MAX_INTERVAL_S = 1.05
"""Longest interval: beyond it the velocities in between are not linear."""

EVALUATED = 10
"""Intervals from one evaluation to the next."""

UNKNOWNS, CHANGES = 11, 2


class StampCheck:
    """Estimator of the delay between the stamp of the estimates and the time at which they were true."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Begin without a delay.

        Parameters
        ----------
        vehicle : gives the scales of thrust, speed and yaw rate; no more of it is used.
        """
        thrusters = vehicle.thrusters[:2]
        self._thrust_N = max(max(t.max_N, -t.min_N) for t in thrusters)
        couple_Nm = sum(t.max_N * t.arm_m for t in thrusters)
        self._scales = path_limits(vehicle).top_mps, 0.5 * couple_Nm / vehicle.yaw.inertia_kgm2
        self._impulse = ThrustImpulse()
        self._reported_ns = 0
        self._last: tuple[int, Array, Array] | None = None  # time (ns), motion, impulses
        self._rows: list[Array] = []  # (D, 13) of the newest intervals
        self._products = np.zeros((len(DELAYS_S), UNKNOWNS + CHANGES, UNKNOWNS + CHANGES))  # of those before
        self._intervals = 0.0
        self.delay_s = 0.0
        """Delay of the estimates, if it is certain (s); 0: none. It changes by more than one step only."""

    def add_report(self, applied: Applied) -> None:
        """Add a report of the actuators.

        Parameters
        ----------
        applied : its thrusts are those that are delivered.
        """
        self._impulse.add(applied)
        self._reported_ns = applied.t_ns

    def update(self, estimate: Estimate, current: CurrentProfile | None) -> None:
        """Add an estimate.

        Parameters
        ----------
        estimate : as it was given; its velocities are not filtered.
        current : at that time, as far as it is known.
        """
        t_ns, last = estimate.t_ns, self._last
        if last is not None and t_ns == last[0]:
            return
        impulses = [self._impulse.until(t_ns - round(delay_s * 1e9)) for delay_s in DELAYS_S.tolist()]
        if impulses[-1] is None or t_ns - self._reported_ns > MAX_INTERVAL_S * 1e9:
            self._last = None
            return
        now = t_ns, self._motion(estimate, current), np.array(impulses) / self._thrust_N
        self._last = now
        if last is None or not 0 < t_ns - last[0] <= MAX_INTERVAL_S * 1e9:
            return
        seconds, (u, v, r, *_) = (t_ns - last[0]) * 1e-9, (0.5 * (last[1] + now[1])).tolist()
        du, _, dr, dcos, dsin = (now[1] - last[1]).tolist()
        forces = seconds * np.array((u, abs(u) * u, r, abs(r) * r, u * v, v * r, 1.0))
        row = np.empty((len(DELAYS_S), UNKNOWNS + CHANGES))
        row[:, :2], row[:, 2:9], row[:, 9:] = now[2] - last[2], forces, (dcos, dsin, du, dr)
        self._rows.append(row)
        self._intervals = math.exp(-seconds / MEMORY_S) * self._intervals + 1.0
        if len(self._rows) == EVALUATED:
            rows = np.array(self._rows).transpose(1, 0, 2)
            self._products = math.exp(-EVALUATED * seconds / MEMORY_S) * self._products + rows.mT @ rows
            self._rows.clear()
            delay_s, evidence = self._most_likely()
            if self._intervals < MIN_INTERVALS or evidence < EVIDENCE_NATS or delay_s < MIN_DELAY_S:
                self.delay_s = 0.0
            elif abs(delay_s - self.delay_s) > STEP_S:
                self.delay_s = round(delay_s, 1)

    def _motion(self, estimate: Estimate, current: CurrentProfile | None) -> Array:
        """Return u, v and r over their scales, and cosine and sine of the heading."""
        (north, east), (speed, rate) = currents_at_depths(current, np.array([estimate.depth_m or 0.0]))[0], self._scales
        north, east = estimate.velocity_north_mps - north, estimate.velocity_east_mps - east
        cos, sin = math.cos(estimate.heading_rad), math.sin(estimate.heading_rad)
        u, v = cos * north + sin * east, cos * east - sin * north
        return np.array((u / speed, v / speed, estimate.yaw_rate_radps / rate, cos, sin))

    def _most_likely(self) -> tuple[float, float]:
        """Return the most likely delay (s), and its evidence against a delay of at most one step (nats)."""
        A, B = (
            self._products[:, :UNKNOWNS, :UNKNOWNS] + 1e-4 * np.eye(UNKNOWNS),
            self._products[:, :UNKNOWNS, UNKNOWNS:],
        )
        explained = (B * np.linalg.solve(A, B)).sum(axis=1)
        left = np.diagonal(self._products, axis1=1, axis2=2)[:, UNKNOWNS:] - explained
        J = 0.5 * (self._intervals - UNKNOWNS) * np.log(np.maximum(left, 0.0) + self._intervals * NOISE**2).sum(axis=1)
        k = int(np.clip(np.argmin(J), 1, len(J) - 2))
        before, at, after = J[k - 1 : k + 2].tolist()
        curvature = before - 2.0 * at + after
        between = 0.5 * (before - after) / curvature if curvature > 0.0 else 0.0
        return STEP_S * (k + min(max(between, -1.0), 1.0)), float(J[:2].min() - J.min())
