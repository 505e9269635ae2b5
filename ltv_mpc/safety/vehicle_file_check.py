"""Vehicle file check: what of file, stamps and installation the motion contradicts is named.

Named are values of the motion fit (``motion_fit.py``) that are far from the file's, certain, and last. The held point
then is not the one that its owner declared, or speeds and stopping distances are others than the file says. They are
not those of the disturbance observer, which takes wind for a current, and its model for what is left.
A wrong model can look like a lever arm, too: by up to 0.25 m with the hull of tests/foreign_plant, which is known by
its data sheet (docs/notes/lever-arm.md).

Estimates that are older than their stamps move the origin to another time, and with a slip of the installation
(``installation_slips.py``) no value of the fit means anything, so while either is named, nothing else is.
Nor is the file while waves carry the vehicle, since what they do to it, no noise of the fit is like, or while the
estimates contradict themselves (``kinematic_filter.py``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from ltv_mpc.messages import Estimate, Health
from ltv_mpc.safety.health import NOMINAL, HealthState
from ltv_mpc.safety.installation_slips import SlipTest
from ltv_mpc.safety.motion_fit import ARM, DELAY, MODEL, TURN, MotionFit

ALARM_M = 0.25
"""Least certain lever arm that raises the alarm: what a wrong model can look like, and less than 0.5 m."""

MIN_DELAY_S, MIN_TURN_RAD = 0.15, math.radians(5.0)
"""Least delay of the estimates, and least error of the heading for certain, that are named."""

TURNED = "the heading is turned: check compass, declination and mounting"

CONFIRMED_S = 10.0
"""Time for which an error must last: the first turns of a run can look like a lever arm for 8 s."""

UNDECLARED = "the estimates turn as if measured away from the declared [reference_point]"

BOUNDED = "the learned current is at its bound"

SLIP = "it looks as if"

LATE = "the estimates are older than their stamps"
STAMP_WHEN_MEASURED = (
    "taken for that old; stamp each with the time at which its state was measured, not with that of its arrival"
)
OR_THRUSTERS = f"{STAMP_WHEN_MEASURED}; or the thrusters answer so much later than lag_s says, and report nothing"

FACTORS = ("mass ahead", 1.25), None, ("moment of inertia", 1.5), ("drag ahead", 1.4), None, ("drag in yaw", 1.25)
"""Names of the model's factors in the order of the states, and the least certain factor between fit and file, either
way, that raises the alarm. Identified vehicles are within 10 %, so that drag over thrust is within 1.22, and a descent
that nearly drifts shows it badly. Velocities that are wrong by 1 cm/s for some seconds can look like 1.4 of the
inertia, by the Munk moment. What is abeam is left out: a hull seldom moves abeam.
"""


class VehicleFileCheck:
    """Alarm of an error of the vehicle file that is large, certain, and lasts."""

    def __init__(self, fit: MotionFit) -> None:
        """Begin without an alarm.

        Parameters
        ----------
        fit : what the motion says of reference point, model and stamps.
        """
        self.fit = fit
        """Vehicle, sea and stamps that explain the motion."""
        self.health = NOMINAL
        """Degraded with the reason while the alarm is on."""
        self.why = ""
        """Reason of the alarm with the learned values; empty without an alarm."""
        self._slips = SlipTest(fit)
        self._since_ns: dict[str, int] = {}  # start of each error, by its name
        self._late_s = 0.0  # delay that is named

    @property
    def late_s(self) -> float:
        """Age of the estimates beyond their stamps that is named (s); 0 if none is.

        While it is named, the motion says nothing of the thrust, either.
        """
        return self._late_s if LATE in self.why else 0.0

    def add(self, estimate: Estimate) -> None:
        """Add an estimate to the fit.

        Parameters
        ----------
        estimate : as it was given; nothing of it is filtered.
        """
        if self.fit.update(estimate):
            self._slips.update()

    def update(self, t_ns: int, *, bounded: bool = False, other_cause: bool = False) -> None:
        """Update the alarm.

        Parameters
        ----------
        t_ns : time of the newest estimate, vehicle time (ns).
        bounded : the learned current is at its bound.
        other_cause : waves carry the vehicle, or the estimates contradict themselves.
        """
        fit = self.fit
        errors = {} if other_cause else dict(_errors(fit))
        if bounded:
            errors[BOUNDED] = f"{BOUNDED}: check estimates, thrusters and vehicle file"
        delay_s = float(fit.x[DELAY])
        if fit.certain[DELAY] > 0.0 and delay_s > MIN_DELAY_S:
            self._late_s = round(delay_s, 1) if abs(delay_s - self._late_s) > 0.1 else self._late_s
            what = STAMP_WHEN_MEASURED if fit.reported_ns else OR_THRUSTERS
            errors[LATE] = f"{LATE} by about {self._late_s:.1f} s: {what}"
        if self._slips.found:
            errors[SLIP] = f"{SLIP} {self._slips.found}: check the installation"
        before = self._since_ns
        self._since_ns = {name: min(before.get(name, t_ns), t_ns) for name in errors}
        lasting = [name for name, since_ns in self._since_ns.items() if t_ns - since_ns >= CONFIRMED_S * 1e9]
        others = {LATE, SLIP} & errors.keys()  # with either, no other error means anything
        if others:
            lasting = [name for name in (SLIP, LATE) if name in lasting][:1]
        self.why = "; ".join(errors[name] for name in lasting)
        why = self.why if others else "; ".join(lasting)  # these keep their values for long
        self.health = HealthState(Health.DEGRADED, why) if lasting else NOMINAL


def _errors(fit: MotionFit) -> Iterator[tuple[str, str]]:
    """Yield name and text of each error of the file that is large for certain."""
    forward_m, starboard_m = fit.x[ARM:MODEL].tolist()
    if math.hypot(*fit.certain[ARM:MODEL]) > ALARM_M:
        along = f"{abs(forward_m):.1f} m {'ahead' if forward_m >= 0.0 else 'astern'}"
        across = f"{abs(starboard_m):.1f} m to {'starboard' if starboard_m >= 0.0 else 'port'}"
        yield UNDECLARED, f"{UNDECLARED}: {along} and {across} of it"
    if abs(fit.certain[TURN]) > MIN_TURN_RAD:
        degrees = math.degrees(fit.x[TURN])
        yield TURNED, f"{TURNED}; {abs(degrees):.0f} degrees {'more' if degrees > 0.0 else 'less'} would fit"
    rows = [MODEL, MODEL + 2, MODEL + 3]  # mass, inertia and drag ahead all seem larger if the thrust is smaller
    logs, certain = fit.x[rows], fit.certain[rows]
    if certain[:2].min() > math.log(1.5) and logs.min() > 0.5 * logs.max():
        factor = math.exp(-logs.mean())
        yield "thrust differs from the vehicle file's", f"thrust looks {factor:.2g} of the file's: clear the thrusters"
        return
    for i, named in enumerate(FACTORS, MODEL):
        if named is not None and abs(fit.certain[i]) > math.log(named[1]):
            name, times = named[0], f"looks {math.exp(fit.x[i]):.2g} of the file's: run `ltv-mpc vehicle identify`"
            yield f"{name} differs from the vehicle file's", f"{name} {times}"
