"""Vehicle file check: name what the motion contradicts in the vehicle file.

The disturbance observer learns the lever arm to the estimated point and the vehicle's model, and the controller plans
with both (``control/disturbance.py``). Learned values that are far from the file's, certain, and last, are errors of
the file: the held point is then not the one that its owner declared, or speeds and stopping distances are others than
the file says. A wrong model can look like an arm, too: by up to 0.25 m with the hull of tests/foreign_plant, which is
known by its data sheet (docs/notes/lever-arm.md).

Estimates that are older than their stamps (``stamp_check.py``) look like another mass, drag or arm, so while they are,
nothing else is named.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ltv_mpc.control.disturbance import Belief
from ltv_mpc.messages import Health
from ltv_mpc.safety.health import NOMINAL, HealthState

ALARM_M = 0.25
"""Lever arm that raises the alarm: what a wrong model can look like, and less than what 0.5 m look like."""

ALARM_FACTOR = 1.25
"""Factor between learned model and file, either way, that raises the alarm: an identified vehicle is within 10 %."""

SIGMAS_OF_ARM, SIGMAS_OF_FACTOR = 3.0, 2.5
"""Lever arm, and logarithm of a factor, over their standard deviations from which they count."""

CONTRADICTED, SIGMAS_IF_CONTRADICTED = 9.0, 1.5
"""Square of the whole model over its covariance from which something is wrong for certain, and what each factor then
needs. With right files it is below 1, with the half or the double of one factor 10 to 80 (docs/notes/wrong-file.md).
"""

CONFIRMED_S = 15.0
"""Time for which both conditions must hold: the first turns of a run can look like a lever arm for 8 s."""

UNDECLARED = "the estimates turn as if measured away from the declared [reference_point]"

BOUNDED = "the learned current is at its bound"

LATE = "the estimates are older than their stamps"
STAMP_WHEN_MEASURED = "stamp each with the time at which its state was measured, not with that of its arrival"

FACTORS = ("mass ahead", None, "moment of inertia", "drag ahead", None, "drag in yaw")
"""Names of the model's factors in the order of the states. Those abeam are left out: a hull seldom moves abeam, so
noise of the estimated velocity looks like them.
"""


class VehicleFileCheck:
    """Alarm of an error of the vehicle file that is large, certain, and lasts."""

    def __init__(self) -> None:
        self.health = NOMINAL
        """Degraded with the reason while the alarm is on."""
        self.why = ""
        """Reason of the alarm with the learned values; empty without an alarm."""
        self._since_ns: dict[str, int] = {}  # start of each error, by its name

    @property
    def stamps_are_late(self) -> bool:
        """True while the alarm is that of late stamps: the motion then says nothing of the thrust, either."""
        return LATE in self.why

    def update(self, t_ns: int, arm: Belief, model: Belief, *, bounded: bool = False, late_s: float = 0.0) -> None:
        """Update the alarm with the newest belief.

        Parameters
        ----------
        t_ns : time of the newest estimate, vehicle time (ns).
        arm : lever arm (2,), forward and starboard (m), and its covariance.
        model : learned model (8,), as ``DisturbanceObserver.model`` gives it, and its covariance.
        bounded : the learned current is at its bound.
        late_s : delay between the state of an estimate and its stamp (s); 0: none is known.
        """
        errors = dict([*_errors_of_arm(arm), *_errors_of_model(model)])
        if bounded:
            errors[BOUNDED] = f"{BOUNDED}: check estimates, thrusters and vehicle file"
        if late_s > 0.0:
            errors = {LATE: f"{LATE} by about {late_s:.1f} s: {STAMP_WHEN_MEASURED}"}
        before = self._since_ns
        self._since_ns = {name: min(before.get(name, t_ns), t_ns) for name in errors}
        lasting = [name for name, since_ns in self._since_ns.items() if t_ns - since_ns >= CONFIRMED_S * 1e9]
        self.why = "; ".join(errors[name] for name in lasting)
        why = self.why if LATE in lasting else "; ".join(lasting)  # the delay keeps its value for long
        self.health = HealthState(Health.DEGRADED, why) if lasting else NOMINAL


def _errors_of_arm(arm: Belief) -> Iterator[tuple[str, str]]:
    """Yield name and text of a lever arm that is long and certain."""
    (forward_m, starboard_m), P = arm
    sd_m = math.sqrt(max(float(np.trace(P)) / 2.0, 0.0))
    if math.hypot(forward_m, starboard_m) > max(ALARM_M, SIGMAS_OF_ARM * sd_m):
        along = f"{abs(forward_m):.1f} m {'ahead' if forward_m >= 0.0 else 'astern'}"
        across = f"{abs(starboard_m):.1f} m to {'starboard' if starboard_m >= 0.0 else 'port'}"
        yield UNDECLARED, f"{UNDECLARED}: {along} and {across} of it"


def _errors_of_model(model: Belief) -> Iterator[tuple[str, str]]:
    """Yield name and text of each factor that is far from 1 and certain."""
    mean, P = model
    least = math.log(ALARM_FACTOR)
    if np.abs(mean).max() <= least:
        return
    contradicted = float(mean @ np.linalg.solve(P, mean)) > CONTRADICTED
    sigmas = SIGMAS_IF_CONTRADICTED if contradicted else SIGMAS_OF_FACTOR
    for i, name in enumerate(FACTORS):
        if name is not None and abs(mean[i]) > max(least, sigmas * math.sqrt(P[i, i])):
            times = f"looks {math.exp(mean[i]):.2g} of the file's: run `ltv-mpc vehicle identify`"
            yield f"{name} differs from the vehicle file's", f"{name} {times}"
