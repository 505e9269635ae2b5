"""Stamp check: whether the estimates are older than their stamps say.

A navigation that stamps its estimates when they arrive gives a state of the time t - d with the stamp t. Its motion
follows the thrusts d later than it should, whatever masses, drag and arms are. From one estimate to the next one

    [du, dr] = theta' phi(d) + e,    phi(d) = [dI_1(d), dI_2(d), u dt, |u| u dt, r dt, |r| r dt, u v dt, v r dt, dt,
                                               d cos psi, d sin psi]

    dI_i(d)     impulse of the reported thrust of port and starboard over the interval, d seconds before
    theta       unknown (11, 2): what thrust, drag, Coriolis and Munk forces, wind and an unknown current do

Least squares with forgetting give for each delay d of ``DELAYS_NS`` the theta that explains the motion best, and sums
of squares s_j(d) that it leaves in surge and yaw. Among N intervals with noise of unknown size

    J(d) = (N - 11)/2 sum over j of log(s_j(d) + N ``NOISE``^2)                                  nats

is the negative log-likelihood. The delay is that of the least J, between the steps by a parabola. It counts with
``EVIDENCE_NATS`` more than a delay of at most one step, and above ``MIN_DELAY_S``. So a wrong vehicle file is no delay,
and thrusters that answer late are none if their reports say what they deliver. Without reports nothing is checked.
Source  Ljung 1999, System identification, section 7.4 (concentrated likelihood), section 11.2 (forgetting).
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from ltv_mpc.control.prediction import currents_at_depths
from ltv_mpc.messages import Applied, Array, CurrentProfile, Estimate, Pair
from ltv_mpc.references.limits import path_limits
from ltv_mpc.safety.thrust_impulse import ThrustImpulse
from ltv_mpc.vehicle.parameters import Vehicle

STEP_S = 0.1
DELAYS_NS = [round(k * STEP_S * 1e9) for k in range(16)]
"""Delays that are compared (ns)."""

MIN_DELAY_S, EVIDENCE_NATS = 0.15, 12.0
"""Least delay that is named, and its least evidence (docs/notes/late-stamps.md)."""

MEMORY_S, MIN_INTERVALS = 90.0, 60.0
"""Time in which an interval is forgotten to e^-1, and the number of intervals from which eleven unknowns are known."""

NOISE, RIDGE = 5e-3, 1e-4
"""Noise of a change of velocity over the top speed, and of a change of yaw rate over the rate of full thrust; and what
is added to the squares of the regressors, so that a motion that shows nothing of an unknown leaves it at zero.
"""

MAX_INTERVAL_NS = 1_050_000_000
"""Longest interval: beyond it the velocities in between are not linear."""

EVALUATED = 10
"""Intervals from one evaluation to the next."""

UNKNOWNS, SIZE = 11, 13
"""Number of unknowns in theta, and of these with du and dr."""


Sample: TypeAlias = tuple[int, tuple[float, ...], list[Pair]]
"""Time of an estimate (ns), its motion, and the impulses (N s) up to that time less each delay."""


class StampCheck:
    """Estimator of the delay between the stamp of the estimates and the time at which they were true."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Begin without a delay.

        Parameters
        ----------
        vehicle : gives the scales of thrust, speed and yaw rate; no more of it is used.
        """
        thrusters = vehicle.thrusters[:2]
        self._thrust_N = max(t.max_N for t in thrusters)
        turning_radps2 = sum(t.max_N * t.arm_m for t in thrusters) / vehicle.yaw.inertia_kgm2
        self._scales = path_limits(vehicle).top_mps, 0.5 * turning_radps2  # of velocity and yaw rate
        self._impulse, self._reported_ns = ThrustImpulse(), 0
        self._last: Sample | None = None
        self._new: list[tuple[Sample, Sample]] = []  # begin and end of the newest intervals
        self._products = np.zeros((len(DELAYS_NS), SIZE, SIZE))  # of those before
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
        impulses = None
        if t_ns - self._reported_ns <= MAX_INTERVAL_NS:
            impulses = self._impulse.until_each(t_ns - delay_ns for delay_ns in DELAYS_NS)
        self._last = None if impulses is None else (t_ns, self._motion(estimate, current), impulses)
        if self._last is None or last is None or not 0 < t_ns - last[0] <= MAX_INTERVAL_NS:
            return
        self._new.append((last, self._last))
        seconds = (t_ns - last[0]) * 1e-9
        self._intervals = math.exp(-seconds / MEMORY_S) * self._intervals + 1.0
        if len(self._new) == EVALUATED:
            rows = self._rows()
            self._products = math.exp(-EVALUATED * seconds / MEMORY_S) * self._products + rows.mT @ rows
            self._new.clear()
            delay_s, evidence = self._most_likely()
            if self._intervals < MIN_INTERVALS or evidence < EVIDENCE_NATS or delay_s < MIN_DELAY_S:
                self.delay_s = 0.0
            elif abs(delay_s - self.delay_s) > STEP_S:
                self.delay_s = round(delay_s, 1)

    def _rows(self) -> Array:
        """Return phi, du and dr of the newest intervals, (D, K, 13)."""
        (begins, before, impulse), (ends, after, later) = (
            (np.array(part) for part in zip(*of, strict=True)) for of in zip(*self._new, strict=True)
        )
        rows = np.empty((len(DELAYS_NS), len(begins), SIZE))
        u, v, r = (0.5 * (before + after)[:, :3]).T
        rows[..., :2] = ((later - impulse) / self._thrust_N).swapaxes(0, 1)
        rows[..., 2:9] = np.stack((u, abs(u) * u, r, abs(r) * r, u * v, v * r, np.ones(len(u))), axis=1)
        rows[..., 2:9] *= ((ends - begins) * 1e-9)[:, None]
        rows[..., 9:] = (after - before)[:, [3, 4, 0, 2]]
        return rows

    def _motion(self, estimate: Estimate, current: CurrentProfile | None) -> tuple[float, ...]:
        """Return u, v and r over their scales, and cosine and sine of the heading."""
        (north, east), (speed, rate) = currents_at_depths(current, np.array([estimate.depth_m or 0.0]))[0], self._scales
        north, east = estimate.velocity_north_mps - float(north), estimate.velocity_east_mps - float(east)
        cos, sin = math.cos(estimate.heading_rad), math.sin(estimate.heading_rad)
        u, v = cos * north + sin * east, cos * east - sin * north
        return u / speed, v / speed, estimate.yaw_rate_radps / rate, cos, sin

    def _most_likely(self) -> tuple[float, float]:
        """Return the most likely delay (s), and its evidence against a delay of at most one step (nats)."""
        A, B = np.split(self._products[:, :UNKNOWNS], [UNKNOWNS], axis=2)
        explained = (B * np.linalg.solve(A + RIDGE * np.eye(UNKNOWNS), B)).sum(axis=1)
        left = np.diagonal(self._products, axis1=1, axis2=2)[:, UNKNOWNS:] - explained
        J = 0.5 * (self._intervals - UNKNOWNS) * np.log(np.maximum(left, 0.0) + self._intervals * NOISE**2).sum(axis=1)
        k = int(np.argmin(J))
        if not 0 < k < len(J) - 1:
            return 0.0, 0.0
        before, at, after = J[k - 1 : k + 2].tolist()
        return STEP_S * (k + 0.5 * (before - after) / (before - 2.0 * at + after)), float(J[:2].min()) - at
