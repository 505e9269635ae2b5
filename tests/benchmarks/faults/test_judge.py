"""Verdicts on runs that are written by hand: violations that must be found, and cases that must pass."""

from __future__ import annotations

import pytest

from benchmarks.faults.__main__ import summary
from benchmarks.faults.judge import FaultOutcome, errors
from benchmarks.faults.judge import judge as judged
from benchmarks.faults.kinds import BOUNDS_M, Fault, Place
from benchmarks.faults.log import INTRUDERS_EPOCH, Case, GateSeen, Log, Observed, PlanSeen, ReportSeen
from ltv_mpc.messages import Health, PlanOrigin, SensorStatus
from ltv_mpc.vehicle.parameters import Vehicle

MS, S = 1_000_000, 1_000_000_000
VEHICLE = Vehicle.load("paper")
CYCLE_NS = 300 * MS
UNTIL_NS = 120 * S
START_S, END_S = 30.0, 40.0


def fault(kind: str, target: str = "estimate", **changes) -> Fault:
    return Fault(kind=kind, target=target, start_s=START_S, end_s=END_S, size=0.5, seed=1, **changes)


def log(*, off_m: float = 0.0, sd_m: float = 1.0, off_s: tuple[float, float] = (0.0, 200.0)) -> Log:
    """Return the log of a vehicle that holds its point 0.1 m off; ``off_m`` north of its own estimate."""
    of = Log(VEHICLE)
    for t in range(0, UNTIL_NS, 100 * MS):
        here = off_m if off_s[0] * S <= t <= off_s[1] * S else 0.0
        of.truth.append((t, 0.1 + here, 0.0, 0.0, 0.0))
        of.estimate.append((t, 0.1, 0.0, 0.0, 0.0))
        of.squares.append((sd_m**2, 0.0, 0.0, sd_m**2, 1.0, 0.0, 0.0, 1.0))
        of.received_estimates.append((t + 10 * MS, t))
        of.applied.append((t, False, 1, 0, 0))
        of.propeller_thrust.append((t, 20.0, 20.0))
        of.gate.append(GateSeen(t, t - t % CYCLE_NS, t - t % CYCLE_NS, Health.NOMINAL))
    for t in range(0, UNTIL_NS, CYCLE_NS):
        of.cycles.append(t)
        of.plans.append(PlanSeen(t, t, PlanOrigin.SOLVED, Health.NOMINAL, "", True))
        of.target.append((t, (0.0, 0.0)))
    of.reports += [ReportSeen(t, True, {}) for t in range(0, UNTIL_NS, S)]
    return of


def judge(of: Log, *cases: Case, baseline: Log | None = None) -> list[FaultOutcome]:
    return judged(1, Place.LOCKSTEP, of, cases, errors(baseline or log()))


def case_of(of: Log, what: Fault, *, ended_s: float = 120.0, uncontrolled: str = "", **changes) -> Case:
    return Case(what, what.start_ns, what.end_ns, Observed(of, round(ended_s * S), uncontrolled, []), **changes)


def seen(of: Log, what: Fault, *, baseline: Log | None = None, **changes) -> FaultOutcome:
    (one,) = judge(of, case_of(of, what, **changes), baseline=baseline)
    return one


def change_plans(of: Log, from_s: float, to_s: float, **changes) -> Log:
    of.plans = [plan._replace(**changes) if from_s * S <= plan.cycle_ns < to_s * S else plan for plan in of.plans]
    return of


def silence(of: Log, end_s: float = END_S) -> Log:
    """No estimate from the fault's start to its end."""
    of.received_estimates = [(received, t) for received, t in of.received_estimates if not START_S * S <= t < end_s * S]
    return of


def test_a_run_that_kept_its_promises_has_nothing_against_it():
    one = seen(log(), fault("external_force", "vehicle"))
    assert (one.late, one.ratio, one.outside_s, one.uncounted, one.bad_thrusts) == ("", pytest.approx(1.0), 0.0, 0, 0)
    assert one.worst_error_m == pytest.approx(0.1)  # it stayed where it began, 0.1 m from where it was to be
    assert one.problems == []


def test_a_cycle_without_a_command_is_late():
    of = log()
    of.plans = [plan for plan in of.plans if plan.cycle_ns != 33 * S]
    assert seen(of, fault("external_force")).late == "1 cycles without a finite command"
    of = change_plans(log(), 33, 33.2, finite=False)
    assert seen(of, fault("external_force")).late == "1 cycles without a finite command"


def test_silence_that_nobody_mentions_is_late_from_its_threshold_on():
    assert "nominal with an estimate" in seen(silence(log()), fault("message_loss")).late


def test_a_silent_instrument_must_be_reported():
    what = fault("sensor_off", "adcp")
    assert "not reported" in seen(log(), what).late
    of = log()
    of.reports = [
        r._replace(wrong={"adcp": SensorStatus.SILENT}) if 32 * S <= r.t_ns < 40 * S else r for r in of.reports
    ]
    one = seen(of, what)
    assert one.late == ""
    assert one.reaction_s == pytest.approx(1.0, abs=1e-6)  # three thirds of a second after the start
    of.reports = [r._replace(wrong={}) if r.t_ns < 35 * S else r for r in of.reports]
    assert "reported 4.0 s after its threshold" in seen(of, what).late


def test_every_frame_that_is_none_must_be_refused():
    of = log()
    of.rejected = [(31 * S + i * S, "controller", "estimate") for i in range(4)]
    of.rejected.append((31 * S, "plant", "plan"))  # of another key
    assert seen(of, fault("not_a_number"), harmed=4).late == ""
    one = seen(of, fault("not_a_number"), harmed=5)
    assert one.uncounted == 1
    assert "1 of 5 frames not rejected" in one.late


def test_every_lost_message_must_be_counted_as_lost():
    assert seen(log(), fault("message_loss"), harmed=7, counted=7).uncounted == 0
    assert seen(log(), fault("message_loss"), harmed=7, counted=5).uncounted == 2


def test_a_second_commander_must_be_refused_and_never_followed():
    what = fault("second_commander", "plant")
    assert "no status reports" in seen(log(), what).late
    of = log()
    of.applied = [(*row[:3], 3, 0) if row[0] >= START_S * S + 100 * MS else row for row in of.applied]
    assert seen(of, what).late == ""
    of.applied = [(*row[:2], INTRUDERS_EPOCH, *row[3:]) if row[0] == 35 * S else row for row in of.applied]
    assert "follows the second commander" in seen(of, what).late


def test_what_is_left_of_the_error_is_held_against_the_same_seed_without():
    of = log()
    of.estimate = [(t, 0.35 if t > 71 * S else n, e, *v) for t, n, e, *v in of.estimate]
    one = seen(of, fault("external_force"))
    assert one.ratio == pytest.approx(3.4, abs=0.1)  # most of 70 to 100 s
    assert summary([one])["not_recovered"] == 1


def test_what_is_lost_may_move_the_true_error_so_far_and_no_further():
    """Compared with what it was when the fault began, however far off the vehicle was by then."""
    what = fault("sensor_off", "compass")
    bound_m = BOUNDS_M["sensor_off", "compass"]
    one = seen(log(off_m=bound_m + 0.1, off_s=(START_S + 1, END_S), sd_m=9.0), what)
    assert one.grown_m == pytest.approx(bound_m + 0.1)
    assert f"bound {bound_m:g} m" in "; ".join(one.problems)
    assert summary([one])["beyond_bound"] == 1
    inside = seen(log(off_m=bound_m - 0.1, off_s=(START_S + 1, END_S), sd_m=9.0), what)
    before = seen(log(off_m=bound_m + 0.1, off_s=(START_S - 1, 200.0), sd_m=9.0), what)
    assert summary([inside, before])["beyond_bound"] == 0
    assert seen(log(), fault("external_force")).bound_m is None
    assert seen(log(), fault("thruster_loss", "both", permanent=True)).bound_m is not None


def test_an_error_beyond_three_sigma_must_be_said():
    off = {"off_m": 4.0, "off_s": (START_S, END_S)}
    one = seen(log(**off), fault("sensor_wrong", "adcp"))
    assert one.outside_s == pytest.approx(10.0, abs=0.2)
    assert one.worst_error_m == pytest.approx(4.1)
    assert seen(log(**off, sd_m=2.0), fault("sensor_wrong", "adcp")).outside_s == 0.0
    of = log(**off)
    of.reports = [r._replace(nominal=False) for r in of.reports]
    assert seen(of, fault("sensor_wrong", "adcp")).outside_s == 0.0


def test_an_end_that_was_not_to_be_is_one():
    what = fault("solver_failure", "raises")
    one = seen(log(), what, uncontrolled="SolverRaised: in trouble")
    assert one.uncontrolled == ""  # it came later than what is judged of this fault
    one = seen(log(), what, uncontrolled="SolverRaised: in trouble", ended_s=35.0)
    assert one.uncontrolled == "SolverRaised: in trouble"
