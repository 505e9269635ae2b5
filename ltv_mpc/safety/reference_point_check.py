"""Reference point check: find a lever arm between the point that the estimates describe and the declared one.

If the estimates describe a point l away from the declared reference point, their velocity contains a part that turns
with the vehicle. In complex numbers, z is the change of velocity from one estimate to the next, observed minus
predicted by the model (north + i east), and l is the lever arm (forward + i starboard):

    z = l d + e,     d = i (r1 exp(i psi1) - r0 exp(i psi0))          heading psi and yaw rate r of both estimates
    l = sum(w conj(d) z) / sum w |d|^2                                least squares over the last minutes
    w = 1 / (1 + (MODEL_ERROR |v1 - v0| / NOISE_MPS)^2)               predicted change of velocity v

This neglects that drag and Coriolis forces also change within an interval, so l is found too small, by up to a half. A
steady course has d = 0 and shows nothing. A wrong model of the thrusters or of sway appears as a lever arm of up to
0.1 m (docs/notes/fault-studies.md).
"""

from __future__ import annotations

import cmath
import math

from ltv_mpc.messages import Estimate, Health, Pair
from ltv_mpc.safety.health import NOMINAL, HealthState

MAX_INTERVAL_NS = 1_000_000_000
"""Longest time between two estimates that are compared."""

MEMORY_S = 120.0
"""Time constant with which old estimates are forgotten."""

ALARM_M = 0.25
"""Lever arm that raises the alarm: twice what a wrong model looks like, less than what 0.5 m look like."""

SIGMAS = 5.0
"""Lever arm over its standard deviation from which it counts."""

CONFIRMED_S = 15.0
"""Time for which both conditions must hold: the first turns of a run can look like a lever arm for 8 s."""

UNDECLARED = "the estimates turn as if measured away from the declared [reference_point]"

NOISE_MPS, NOISE_ROWS = 0.005, 20.0
"""Prior of the residuals' standard deviation, and its weight in estimates."""

MODEL_ERROR = 0.1
"""Error of a predicted change of velocity over the change: a thruster follows its command otherwise than the model."""


class ReferencePointCheck:
    """Least-squares estimate of the lever arm, and the alarm that it raises."""

    def __init__(self) -> None:
        self.health = NOMINAL
        """Degraded with the reason while the alarm is on."""
        self._last: Estimate | None = None
        self._last_turning = 0j
        self._weight = 0.0  # sum w |d|^2
        self._product = 0j  # sum w conj(d) z
        self._rows, self._squares = NOISE_ROWS, NOISE_ROWS * NOISE_MPS**2  # sum w, sum w |z|^2
        self._exceeded_s = 0.0

    def update(self, estimate: Estimate, predicted_mps: Pair | None) -> None:
        """Compare an estimate with the prediction from the last one.

        Parameters
        ----------
        estimate : newest accepted estimate of the vehicle's origin.
        predicted_mps : its velocity over ground, north and east (m/s), as the model predicts it from the last estimate;
            None if there is no prediction.
        """
        last = self._last
        if last is not None and estimate.t_ns == last.t_ns:
            return
        self._last = estimate
        before, self._last_turning = self._last_turning, _turning(estimate)
        if last is None or predicted_mps is None or not 0 < estimate.t_ns - last.t_ns <= MAX_INTERVAL_NS:
            return
        d = self._last_turning - before
        predicted = complex(*predicted_mps)
        z = complex(estimate.velocity_north_mps, estimate.velocity_east_mps) - predicted
        if not cmath.isfinite(z):
            return
        interval_s = (estimate.t_ns - last.t_ns) * 1e-9
        kept = math.exp(-interval_s / MEMORY_S)
        change = predicted - complex(last.velocity_north_mps, last.velocity_east_mps)
        w = 1.0 / (1.0 + (MODEL_ERROR * abs(change) / NOISE_MPS) ** 2)
        self._weight = kept * self._weight + w * abs(d) ** 2
        self._product = kept * self._product + w * d.conjugate() * z
        self._rows = kept * self._rows + w
        self._squares = kept * self._squares + w * abs(z) ** 2
        self._decide(interval_s)

    @property
    def why(self) -> str:
        """Reason of the alarm with the lever arm; empty without an alarm."""
        if self.health is NOMINAL:
            return ""
        arm_m = self._product / self._weight
        along = f"{abs(arm_m.real):.1f} m {'ahead' if arm_m.real >= 0.0 else 'astern'}"
        across = f"{abs(arm_m.imag):.1f} m to {'starboard' if arm_m.imag >= 0.0 else 'port'}"
        return f"{UNDECLARED}: {along} and {across} of it"

    def _decide(self, interval_s: float) -> None:
        """Update the alarm after an interval (s)."""
        if self._weight == 0.0:
            return
        arm_m = self._product / self._weight
        unexplained = max(self._squares - abs(self._product) ** 2 / self._weight, 0.0)
        sd_m = math.sqrt(0.5 * unexplained / self._rows / self._weight)  # of each component
        if abs(arm_m) <= max(ALARM_M, SIGMAS * sd_m):
            self._exceeded_s, self.health = 0.0, NOMINAL
            return
        self._exceeded_s += interval_s
        if self._exceeded_s >= CONFIRMED_S:
            self.health = HealthState(Health.DEGRADED, UNDECLARED)


def _turning(estimate: Estimate) -> complex:
    """Return the velocity over ground, north + i east, of a point 1 m ahead of a turning vehicle (m/s)."""
    return 1j * estimate.yaw_rate_radps * cmath.exp(1j * estimate.heading_rad)
