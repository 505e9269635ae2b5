"""Actuator check: the commands that the actuators report, against those of the plans that were sent.

A report agrees if a plan that may be in force asks for its commands, or if they approach that plan at the slew limit.
That is the plan that the report names as accepted, or the one before until it begins. If the report names none, or one
that was replaced more than ``LATE_NS`` ago, each plan that was in force within ``LATE_NS`` may be: a plan can be late.
A report that says why the plans are not followed contradicts them in any case, and degrades the health at once. Each
plan begins at the reported command, so actuators that do not follow agree for a moment with each new plan; a
contradiction ends only after a time of agreement.
"""

from __future__ import annotations

from ltv_mpc.conversion import exact
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Applied, Array, Health, Plan, Triple
from ltv_mpc.safety.health import NOMINAL, HealthState
from ltv_mpc.safety.plan_queue import PlanQueue
from ltv_mpc.vehicle.parameters import Vehicle

CONTRADICTED_NS = 1_000_000_000
"""Duration of a contradiction from which the health is degraded."""

LATE_NS = 1_000_000_000
"""Lateness of a plan that is no contradiction."""

SETTLED_NS, AGREED_NS = 500_000_000, 1_000_000_000
"""Agreement that ends a contradiction before and after the health is degraded; at least one period of the plans."""

SHARE, SLEW_SHARE = 0.05, 0.5
"""Tolerance: share of the largest thrust, and at most this share of what a thruster can change in a plan period.
Actuators at rest are farther than that from a plan that begins with them, before the next one replaces it.
"""

CATCH_UP_SHARE = 0.8
"""Share of the slew limit from which a command approaches a plan that came late."""

BEYOND = 3.0
"""Largest thrust that is believed, over that of the file's strongest thruster."""

UNUSABLE = "a report of the actuators cannot be used: "
"""Start of the health's reason from a report with a number that is none, or out of its bounds, to the next good one."""

NOT_DRIVING = "not driving: "
"""Start of the health's reason while the actuators report why they do not follow the plans."""

WHAT_IT_CAN_BE = "released, or driven by somebody else?"


class ActuatorCheck:
    """Plans that were sent, and whether the actuators' reports contradict them."""

    def __init__(self, vehicle: Vehicle, period_ns: int) -> None:
        """Begin without a plan.

        Parameters
        ----------
        vehicle : gives the limits of its thrusters.
        period_ns : period of the plans (ns).
        """
        thrusters = vehicle.thrusters[: 3 if vehicle.can_dive else 2]
        self._tolerance_N = [
            min(SHARE * max(-t.min_N, t.max_N), SLEW_SHARE * t.slew_N_per_s * period_ns * 1e-9) for t in thrusters
        ]
        self._most_N = BEYOND * max(max(-t.min_N, t.max_N) for t in vehicle.thrusters)
        self._slew_N_per_s = [t.slew_N_per_s for t in thrusters]
        self._last: tuple[int, Triple] = 0, (0.0, 0.0, 0.0)  # time and commands of the last report
        self._period_ns = period_ns
        self._plans = PlanQueue(vehicle.plan_timeout_s)  # that were sent
        self._since_ns: int | None = None  # first report of a contradiction
        self._until_ns = 0  # its last report
        self._agreed_ns = 0  # last report that agreed
        self.began_ns: int | None = None
        """Time of the last report before a contradiction; the controller clears it when it has taken back what it has
        learned since."""
        self.overridden = False
        """The plans of the last cycle were an override's."""
        self.health = NOMINAL
        """Degraded with the reason once a contradiction has lasted."""

    @property
    def disagrees(self) -> bool:
        """True from the first report that contradicts the plans, until they agree for a time."""
        return self._since_ns is not None

    @property
    def learns(self) -> bool:
        """False while nothing is to be learned from the motion: under an override, and during a contradiction."""
        return not self.overridden and not self.disagrees

    def sent(self, plan: Plan) -> None:
        """Add a plan that was sent; it replaces those that begin later.

        Parameters
        ----------
        plan : is in force from its first knot on.
        """
        self._plans.add(plan, plan.cycle_t_ns)

    def usable(self, applied: Applied) -> Applied | None:
        """Return a report whose numbers have their types and are thrusts; else None, and the health says so.

        Parameters
        ----------
        applied : report.
        """
        try:
            applied = exact(applied)
            if all(abs(thrust_N) <= self._most_N for thrust_N in applied.thrust_N + applied.command_N):  # not if NaN
                return applied
            reason = f"more than {self._most_N:.0f} N"
        except ConfigError as error:
            reason = str(error)
        self.health = HealthState(Health.DEGRADED, f"{UNUSABLE}{reason}")
        return None

    def add(self, applied: Applied) -> None:
        """Compare a report with the plans; one from before the first known plan is ignored.

        Parameters
        ----------
        applied : report, newer than the last.
        """
        t_ns = applied.t_ns
        if self._since_ns is not None and t_ns < self._until_ns:
            self._since_ns, self.health = None, NOMINAL  # the clock was set back
        (last_ns, last_N), command_N = self._last, applied.command_N
        self._last = t_ns, command_N
        if applied.why:
            self._contradicted(t_ns)
            self.health = HealthState(Health.DEGRADED, f"{NOT_DRIVING}{applied.why}")
            return
        if self.health.why.startswith((NOT_DRIVING, UNUSABLE)):
            self.health = NOMINAL
        plans = self._in_force(applied)
        if not plans:
            return
        seconds, of_each = max(t_ns - last_ns, 1) * 1e-9, zip(command_N, last_N, self._slew_N_per_s, strict=False)
        changes = [(now_N - before_N) / (slew * seconds) for now_N, before_N, slew in of_each]
        if any(self._agrees((plan.thrust_at(t_ns) - command_N).tolist(), changes) for plan in plans):
            agreed_ns = max(SETTLED_NS if self.health is NOMINAL else AGREED_NS, self._period_ns)
            if self._since_ns is not None and t_ns - self._until_ns >= agreed_ns:
                self._since_ns, self.health = None, NOMINAL
            if self._since_ns is None:
                self._agreed_ns = t_ns
            return
        if t_ns - self._contradicted(t_ns) > CONTRADICTED_NS and self.health is NOMINAL:
            reported, asked = self._text(command_N), self._text(plans[0].thrust_at(t_ns))
            why = f"the actuators command {reported} N, the plan in force {asked} N: {WHAT_IT_CAN_BE}"
            self.health = HealthState(Health.DEGRADED, why)

    def _contradicted(self, t_ns: int) -> int:
        """Note a contradiction; return the time of its first report."""
        if self._since_ns is None:
            self._since_ns = t_ns
            self.began_ns = self._agreed_ns or t_ns
        self._until_ns = t_ns
        return self._since_ns

    def _in_force(self, applied: Applied) -> list[Plan]:
        """Return the plans that may be in force at a report, the newest first; none if that is not known."""
        t_ns, recent = applied.t_ns, []
        for plan in self._plans.begun(t_ns):
            recent.append(plan)
            if plan.t_ns[0] <= t_ns - LATE_NS:
                break
        named = applied.plan_sequence >= 0 and self._plans.holds(applied.plan_cycle_t_ns)
        accepted = [plan for plan in recent if named and plan.cycle_t_ns <= applied.plan_cycle_t_ns][:1]
        if not accepted and recent and recent[-1].t_ns[0] > t_ns - LATE_NS:
            return []  # another controller's plan, which is not known, may be in force
        return [plan for plan in accepted or recent if self._plans.end_ns(plan) >= t_ns]

    def _agrees(self, missing_N: list[float], changes: list[float]) -> bool:
        """Return True if each command is that of a plan, or approaches it.

        ``missing_N`` is what a plan asks for beyond the commands, ``changes`` the change of each command since the last
        report, over that at the slew limit.
        """
        return all(
            abs(missing) <= tolerance or missing * change >= CATCH_UP_SHARE * abs(missing)
            for missing, change, tolerance in zip(missing_N, changes, self._tolerance_N, strict=False)
        )

    def _text(self, thrust_N: Array | Triple) -> str:
        return " / ".join(f"{thrust:.1f}" for thrust in thrust_N[: len(self._tolerance_N)])
