"""Reaction rules: the reaction that each fault class requires, and whether it came in time.

Every fault requires a finite command each cycle, a health of the controller that matches the age of the newest
estimate, and a health of the actuators that shows missing plans. ``RULES`` has the further requirements of each class.
A rule reads the messages of a run only, and nothing inside a node.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.faults.kinds import AFLOAT, INSTRUMENTS, MESSAGES
from benchmarks.faults.log import INTRUDERS_EPOCH, REPORT_NS, Case, Reaction
from ltv_mpc.messages import Health, PlanOrigin
from services.bus.topics import BY_TYPE

LEVELS = ((Health.FAILSAFE, 6, 20.0), (Health.HOLD, 4, 10.0), (Health.DEGRADED, 3, 0.5))
"""Health by the age of the newest estimate: worse than this many periods and seconds, worst first."""

SEVERITY = {Health.NOMINAL: 0, Health.DEGRADED: 1, Health.HOLD: 2, Health.FAILSAFE: 3}

FUTURE_NS = 50_000_000
"""Largest lead of an estimate's stamp over its arrival at which the stamp still shows the estimate's age."""

SPACINGS = 9
"""Number of intervals whose median is the period of the estimates."""

REPLACEMENTS, MIN_SILENCE_S = 5, 0.5
"""Half periods without a plan after which the second replacement is missing, and the shortest silence that counts."""

APPLIED_NS = 100_000_000
SILENT_PERIODS = 3
CYCLE_NS = 300_000_000

NAMED_NS = 60_000_000_000
"""Longest time until an antenna 0.5 m off is named: two turns, and 15 s of confirmation."""

STEP_S = 1.5
"""Longest time (s) until a step of the clock is recognised; a small one backwards needs three receipts of plans."""

ALARM_NEWTON_S = 10.0
"""Largest lost impulse (N s) before the alarm of the model check."""

CHECK_NS = 1_000_000_000
"""Time between two messages of the model check."""


def reaction(case: Case) -> Reaction:
    """Return the slowest of the reactions that every fault and the fault's class require."""
    if case.back is not None:
        return case.back
    rules = (_a_command_each_cycle, _health_by_age, _plans_keep_up, *RULES.get(case.fault.kind, ()))
    reactions = [rule(case) for rule in rules]
    took = [one.seconds for one in reactions if one.seconds is not None]
    return Reaction(max(took) if took else None, "; ".join(one.late for one in reactions if one.late))


def uncounted(case: Case) -> int:
    """Count the harmed messages that their reader had to count and did not."""
    match case.fault.kind:
        case "not_a_number" | "message_duplicate" | "message_reorder":
            return max(0, case.harmed - _refused(case))
        case "message_corruption" if case.of.accepted is None:
            return 0  # what decodes to a message that is fit is none that its reader could know
        case "message_corruption":
            accepted = sum(case.start_ns <= t <= case.end_ns for t in case.of.accepted or ())
            return max(0, case.harmed - accepted - _refused(case))
        case "message_loss":
            return max(0, case.harmed - case.counted)
        case _:
            return 0


def _refused(case: Case) -> int:
    """Count the rejected frames of the harmed keys, until the last frame that the fault affected can have arrived."""
    keys = {BY_TYPE[kind].key for kind in MESSAGES[case.fault.target]}
    until_ns = case.end_ns + 2 * REPORT_NS
    return sum(key in keys and case.start_ns <= t <= until_ns for t, _, key in case.of.log.rejected)


# --- of every fault --------------------------------------------------------------------------------------------------


def _a_command_each_cycle(case: Case) -> Reaction:
    """Check that each cycle ends in a finite plan of that cycle."""
    log = case.of.log
    first_ns = log.plans[0].cycle_ns if log.plans else math.inf
    if case.fault.kind == "controller_restart":
        first_ns = case.end_ns
    until_ns = min(case.end_ns + REPORT_NS, case.of.until_ns - 2 * REPORT_NS)  # of the last the plan is under way
    made = {plan.cycle_ns for plan in log.plans if plan.finite}
    without = [t for t in log.cycles if max(case.start_ns, first_ns) <= t <= until_ns and t not in made]
    missing = len(without) - case.lost_plans
    return Reaction(None, f"{missing} cycles without a finite command" if missing > 0 else "")


def _health_by_age(case: Case) -> Reaction:
    """Check that at each cycle the health is at least as severe as the age of the newest estimate requires."""
    log = case.of.log
    plans = {plan.cycle_ns: plan for plan in log.plans}
    took: float | None = None
    received, stamps = iter([*log.received_estimates, (10**19, 0)]), [-(10**18)]
    received_ns, stamp_ns = next(received)
    for cycle_ns in log.cycles:
        while received_ns <= cycle_ns:
            if stamps[-1] < stamp_ns <= received_ns + FUTURE_NS:
                stamps.append(stamp_ns)
            received_ns, stamp_ns = next(received)
        plan = plans.get(cycle_ns)
        if plan is None or not case.start_ns <= cycle_ns <= case.end_ns + 2 * REPORT_NS:
            continue
        level, over_ns = _asked_for(cycle_ns - stamps[-1], stamps)
        if SEVERITY[plan.health] < SEVERITY[level]:
            age_s = (cycle_ns - stamps[-1]) * 1e-9
            return Reaction(None, f"{plan.health} with an estimate {age_s:.2f} s old: {level} is required")
        if 0 < over_ns <= CYCLE_NS:
            took = max(took or 0.0, over_ns * 1e-9)
    return Reaction(took)


def _asked_for(age_ns: int, stamps: list[int]) -> tuple[Health, int]:
    """Return the health that an estimate of this age requires, and by how much the age exceeds its threshold (ns)."""
    spacings = sorted(np.diff(stamps[-SPACINGS - 1 :]).tolist())
    period_ns = int(spacings[len(spacings) // 2]) if len(stamps) > 2 else 0
    for level, periods, seconds in LEVELS:
        over_ns = age_ns - max(periods * period_ns, round(seconds * 1e9))
        if over_ns > 0:
            return level, over_ns
    return Health.NOMINAL, 0


def _plans_keep_up(case: Case) -> Reaction:
    """Check that the actuators do not report nominal health while two planned replacements are missing."""
    took: float | None = None
    cycles: list[int] = []
    for seen in case.of.log.gate:
        if not cycles or seen.cycle_ns != cycles[-1]:
            cycles.append(seen.cycle_ns)
        if not case.start_ns <= seen.t_ns <= case.end_ns + 2 * REPORT_NS:
            continue
        spacings = sorted(np.diff(cycles[-SPACINGS - 1 :]).tolist())
        period_ns = int(spacings[len(spacings) // 2]) if spacings else CYCLE_NS
        over_ns = seen.t_ns - seen.received_ns - max(REPLACEMENTS * period_ns // 2, round(MIN_SILENCE_S * 1e9))
        if over_ns > 0 and seen.health is Health.NOMINAL:
            silent_s = (seen.t_ns - seen.received_ns) * 1e-9
            return Reaction(None, f"the actuators are nominal {silent_s:.2f} s after the last plan they accepted")
        if 0 < over_ns <= APPLIED_NS:
            took = max(took or 0.0, over_ns * 1e-9)
    return Reaction(took)


# --- by class --------------------------------------------------------------------------------------------------------


def _silence_flagged(case: Case) -> Reaction:
    """Check that the first report after three missing messages flags the instrument as silent."""
    name, fault = case.fault.target, case.fault
    if name == "imu":
        return Reaction(None)  # without it there is neither estimate nor report, which the health shows
    threshold_ns = case.start_ns + SILENT_PERIODS * BY_TYPE[INSTRUMENTS[name]].period_ns
    until_ns = min(case.end_ns, 0) if name in AFLOAT else case.end_ns
    due = [report for report in case.of.log.reports if threshold_ns + REPORT_NS < report.t_ns <= until_ns]
    if not due:
        return Reaction(None)
    detected = next((r for r in case.of.log.reports if threshold_ns < r.t_ns <= until_ns and name in r.wrong), None)
    if detected is None:
        return Reaction(None, f"silent for {fault.end_s - fault.start_s:.1f} s, not reported")
    seconds = (detected.t_ns - threshold_ns) * 1e-9
    late = f"reported {seconds:.1f} s after its threshold" if detected.t_ns > due[0].t_ns else ""
    return Reaction(seconds, late)


def _refused_at_the_door(case: Case) -> Reaction:
    """Check that every harmed frame is rejected and counted on arrival."""
    missing = uncounted(case)
    return Reaction(0.0 if case.harmed else None, f"{missing} of {case.harmed} frames not rejected" if missing else "")


def _another_origin(case: Case) -> Reaction:
    """Check that a cycle with a failing solver reports it as the plan's origin; the second cycle after it must be
    solved again.
    """
    plans = [plan for plan in case.of.log.plans if plan.cycle_ns >= case.start_ns]
    during = [plan for plan in plans if plan.cycle_ns < case.end_ns]
    if any(plan.origin is PlanOrigin.SOLVED for plan in during):
        return Reaction(None, "a plan is marked solved although the solver failed")
    after = [plan for plan in plans if plan.cycle_ns >= case.end_ns][1:2]
    if any(plan.origin is not PlanOrigin.SOLVED for plan in after):
        return Reaction(0.0, "not solved in the second cycle after the fault")
    return Reaction(0.0 if during else None)


def _misses_counted(case: Case) -> Reaction:
    """Check that each plan that came after its start is counted as a deadline miss in the plant's next report."""
    before = [late for t, *_, late in case.of.log.applied if t <= case.start_ns]
    after = [late for t, *_, late in case.of.log.applied if t <= case.end_ns + 3 * REPORT_NS]
    slow = [p for p in case.of.log.plans if case.start_ns <= p.cycle_ns < case.end_ns]
    if slow and after[-1] == before[-1]:
        return Reaction(None, f"{len(slow)} slow cycles, and no deadline miss is counted")
    return Reaction(0.0 if slow else None)


def _not_followed(case: Case) -> Reaction:
    """Check that no plan of a second commander comes into force and that one is rejected in the same cycle."""
    during = [row for row in case.of.log.applied if case.start_ns <= row[0] <= case.end_ns + REPORT_NS]
    if any(epoch == INTRUDERS_EPOCH for _, _, epoch, *_ in during):
        return Reaction(None, "the plant follows the second commander")
    rejected = [t for t, reader, key in case.of.log.rejected if reader == "plant" and t >= case.start_ns]
    before = [count for t, *_, count, _ in case.of.log.applied if t < case.start_ns]
    rejected += [t for t, *_, count, _ in during if count > before[-1]]
    if not rejected:
        return Reaction(None, "no status reports the rejected second commander")
    return Reaction(max(0.0, (min(rejected) - case.start_ns) * 1e-9))


def _alarm_in_time(case: Case) -> Reaction:
    """Check that the model check raises its alarm once the lost thrust has cost ``ALARM_NEWTON_S`` of impulse."""
    of, lost_Ns, last_ns = case.fault, 0.0, case.start_ns
    shares = (of.size if of.target != "starboard" else 0.0, of.size if of.target != "port" else 0.0)
    due_ns = None
    for t_ns, port_N, starboard_N in case.of.log.propeller_thrust:
        if case.start_ns < t_ns <= min(case.end_ns, case.of.until_ns):
            lost_Ns += (t_ns - last_ns) * 1e-9 * (shares[0] * abs(port_N) + shares[1] * abs(starboard_N))
            last_ns = t_ns
            if lost_Ns >= ALARM_NEWTON_S:
                due_ns = t_ns
                break
    detected = next(
        (t for t, alarm in case.of.log.alarms if alarm and case.start_ns <= t <= case.end_ns + REPORT_NS), None
    )
    if due_ns is None or due_ns + CHECK_NS > case.end_ns:
        return Reaction(None)
    if detected is None:
        return Reaction(
            None, f"no alarm, {ALARM_NEWTON_S:g} N s were lost {(due_ns - case.start_ns) * 1e-9:.1f} s after it began"
        )
    seconds = (detected - due_ns) * 1e-9
    return Reaction(
        seconds, f"alarm {seconds:.1f} s after {ALARM_NEWTON_S:g} N s were lost" if detected > due_ns + CHECK_NS else ""
    )


def _second_source_reported(case: Case) -> Reaction:
    """Check that each cycle after the first message of a second source is degraded and names it."""
    during = [plan for plan in case.of.log.plans if case.start_ns + CYCLE_NS <= plan.cycle_ns < case.end_ns]
    silent = [plan for plan in during if plan.health is Health.NOMINAL or "second source" not in plan.health_why]
    if silent:
        return Reaction(None, f"{len(silent)} of {len(during)} cycles do not report the second source")
    return Reaction(0.0 if during else None)


def _step_recognised(case: Case) -> Reaction:
    """Check that the step of the clock is recognised in time, and that the controller is never worse than degraded."""
    log, until_ns = case.of.log, case.end_ns
    worse = [p for p in log.plans if case.start_ns <= p.cycle_ns < until_ns and SEVERITY[p.health] > 1]
    if worse:
        return Reaction(None, f"{worse[0].health} after a step of the clock")
    told = next((t for t in log.clock_steps if case.start_ns <= t < until_ns), None)
    if told is None:
        return Reaction(None, "the step of the clock was not recognised")
    seconds = (told - case.start_ns) * 1e-9
    return Reaction(seconds, f"recognised after {seconds:.1f} s" if seconds > STEP_S else "")


def _reference_point_named(case: Case) -> Reaction:
    """Check that the model check names the reference point in time, if the fault lasts long enough."""
    if case.end_ns - case.start_ns < NAMED_NS:
        return Reaction(None)
    named = next((t for t in case.of.log.named_points if case.start_ns <= t <= case.end_ns), None)
    if named is None:
        return Reaction(None, "the model check does not name the reference point")
    seconds = (named - case.start_ns) * 1e-9
    return Reaction(seconds, f"named after {seconds:.1f} s" if seconds > NAMED_NS * 1e-9 else "")


def _continues(case: Case) -> Reaction:
    """Check that the second plan of a restarted controller is solved: it is armed and follows its reference."""
    after = [plan for plan in case.of.log.plans if plan.cycle_ns >= case.end_ns][:2]
    if len(after) < 2:
        return Reaction(None)
    seconds = (after[1].cycle_ns - case.end_ns) * 1e-9
    return Reaction(seconds, "" if after[1].origin is PlanOrigin.SOLVED else f"its second plan is {after[1].origin}")


RULES: Mapping[str, tuple[Callable[[Case], Reaction], ...]] = {
    "sensor_off": (_silence_flagged,),
    "message_reorder": (_refused_at_the_door,),
    "message_duplicate": (_refused_at_the_door,),
    "message_corruption": (_refused_at_the_door,),
    "not_a_number": (_refused_at_the_door,),
    "solver_failure": (_another_origin,),
    "solver_overrun": (_misses_counted,),
    "second_commander": (_not_followed,),
    "thruster_loss": (_alarm_in_time,),
    "second_source": (_second_source_reported,),
    "clock_step": (_step_recognised,),
    "reference_point": (_reference_point_named,),
    "controller_restart": (_continues,),
}
"""Requirements of a class beyond those of all classes."""
