"""Reference point check: name a lever arm between the point that the estimates describe and the declared one.

The disturbance observer estimates and corrects the arm (``control/disturbance.py``). A long one is an error of the
vehicle file: the held point is then not the one that its owner declared. A wrong model can look like an arm, too: by up
to 0.25 m with the hull of tests/foreign_plant, which is known by its data sheet (docs/notes/lever-arm.md).
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.messages import Array, Health
from ltv_mpc.safety.health import NOMINAL, HealthState

ALARM_M = 0.25
"""Lever arm that raises the alarm: what a wrong model can look like, and less than what 0.5 m look like."""

SIGMAS = 3.0
"""Lever arm over its standard deviation from which it counts."""

CONFIRMED_S = 15.0
"""Time for which both conditions must hold: the first turns of a run can look like a lever arm for 8 s."""

UNDECLARED = "the estimates turn as if measured away from the declared [reference_point]"


class ReferencePointCheck:
    """Alarm of a lever arm that is long, certain, and lasts."""

    def __init__(self) -> None:
        self.health = NOMINAL
        """Degraded with the reason while the alarm is on."""
        self.why = ""
        """Reason of the alarm with the lever arm; empty without an alarm."""
        self._short_ns: int | None = None  # when the arm was short or uncertain last

    def update(self, t_ns: int, arm_m: Array, covariance: Array) -> None:
        """Update the alarm with the newest belief.

        Parameters
        ----------
        t_ns : time of the newest estimate, vehicle time (ns).
        arm_m : (2,) lever arm, forward and starboard (m).
        covariance : (2, 2) its covariance (m^2).
        """
        length_m = math.hypot(*arm_m)
        sd_m = math.sqrt(max(float(np.trace(covariance)) / 2.0, 0.0))
        if self._short_ns is None or t_ns < self._short_ns or length_m <= max(ALARM_M, SIGMAS * sd_m):
            self._short_ns, self.health, self.why = t_ns, NOMINAL, ""
        elif t_ns - self._short_ns >= CONFIRMED_S * 1e9:
            forward_m, starboard_m = arm_m
            along = f"{abs(forward_m):.1f} m {'ahead' if forward_m >= 0.0 else 'astern'}"
            across = f"{abs(starboard_m):.1f} m to {'starboard' if starboard_m >= 0.0 else 'port'}"
            self.health = HealthState(Health.DEGRADED, UNDECLARED)
            self.why = f"{UNDECLARED}: {along} and {across} of it"
