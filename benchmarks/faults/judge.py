"""Verdict on a run with faults: one ``FaultOutcome`` for each fault, from the messages of the run alone.

reaction   by the class (``reactions.py``)
error      largest true horizontal error from the fault's start until a minute after its end
grown      largest change of that error since the start of the fault; a lost sensor has a bound for it
recovery   mean tracking error 30 to 60 s after its end over that of the same seed without any fault: the larger of its
           means in the same half minute and under water in all. A vehicle that holds its place is off it by a few
           centimetres that come and go: of two half minutes of one run without faults the one is more than twice the
           other in some 10 % of cases, which says nothing about the fault.
outside    time for which position or velocity was outside 3 sigma (chi-square of two degrees of freedom), neither
           the report nor the health flagged it, and the same seed without faults was inside
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from benchmarks.faults import kinds
from benchmarks.faults.kinds import Fault, Place
from benchmarks.faults.log import Case, Log
from benchmarks.faults.reactions import reaction, uncounted
from ltv_mpc.messages import Array, Health

RECOVERED = 2.0
"""Largest ratio of the mean tracking error after a fault to that without faults."""

UNFLAGGED_S = 10.0
"""Longest time (s) for which an error may be outside 3 sigma unflagged: one window of innovations."""

WAIT_S = 10.0
"""Longest time (s) from a signal to the end of the run."""

THREE_SIGMA = 11.829
"""Chi-square quantile of two degrees of freedom at 99.73 %, the probability of 3 sigma of a normal variable."""

AFTER_NS = (30_000_000_000, 60_000_000_000)
FLAG_NS = 1_100_000_000
"""Longest delay of a flag: localisation reports come each second."""


class FaultOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of one fault. None: it does not apply, or could not be observed."""

    fault: Fault
    place: Place
    run_seed: int
    harmed: int = 0  # messages that it harmed
    reaction_s: float | None = None  # from when a reaction was due to the reaction
    late: str = ""  # why the reaction was late; empty: it was in time
    worst_error_m: float | None = None  # true horizontal error until a minute after its end
    grown_m: float | None = None  # by how much that error moved, at most, from what it was at the start
    bound_m: float | None = None  # of ``grown_m``: where an instrument or a thruster is lost
    ratio: float | None = None  # mean tracking error 30 to 60 s after its end over that of the same seed without
    outside_s: float = 0.0  # the true error was outside 3 sigma and nothing flagged it
    uncounted: int = 0  # messages harmed that nobody counted
    bad_thrusts: int = 0  # commands not finite, or outside box or slew, in the plant's own record
    uncontrolled: str = ""  # how the run ended, where that was not to be
    false_figures: str = ""  # of the run's summary; stated with its last fault
    wait_s: float | None = None  # from a signal to the run's end, likewise

    @property
    def recovered(self) -> bool:
        """True unless the tracking error stayed larger."""
        return self.ratio is None or self.ratio <= RECOVERED

    @property
    def beyond_bound(self) -> bool:
        """True if the true error moved further than it may."""
        return self.bound_m is not None and self.grown_m is not None and not self.grown_m <= self.bound_m

    @property
    def problems(self) -> list[str]:
        """The requirements that were violated for this fault."""
        found = {
            f"ended: {self.uncontrolled}": self.uncontrolled,
            self.late: self.late,
            f"{self.bad_thrusts} bad thrusts": self.bad_thrusts,
            f"{self.uncounted} uncounted messages": self.uncounted,
            f"tracking error {self.ratio or 0.0:.1f} times that of the run without the fault": not self.recovered,
            f"true error moved by {self.grown_m or 0.0:.1f} m, bound {self.bound_m or 0.0:g} m": self.beyond_bound,
            f"false figures: {self.false_figures}": self.false_figures,
            f"ended {self.wait_s or 0.0:.1f} s after the signal": (self.wait_s or 0.0) > WAIT_S,
            f"outside 3 sigma for {self.outside_s:.0f} s, unflagged": self.outside_s > UNFLAGGED_S,
        }
        return [text for text, holds in found.items() if holds]


class Errors(NamedTuple):
    """Errors at the times of the estimates after t = 0: tracking error (m), true error north and east (m), (K, 2), and
    whether the truth is outside 3 sigma.
    """

    t_ns: Array
    tracking_m: Array
    true_m: Array
    outside: npt.NDArray[np.bool_]


def errors(log: Log) -> Errors:
    """Compute the errors from estimates, truth and targets."""
    estimate, squares = np.array(log.estimate).reshape(-1, 5), np.array(log.squares).reshape(-1, 8)
    known = estimate[:, 0] > 0
    at, there = estimate[known, 0], estimate[known, 1:]
    truth = np.array(log.truth)
    true = np.column_stack([np.interp(at, truth[:, 0], truth[:, i]) for i in range(1, 5)])
    if not log.target or not len(at):
        nothing = np.empty(0)
        return Errors(nothing, nothing, np.empty((0, 2)), nothing.astype(np.bool_))
    since = np.array([t for t, _ in log.target])
    places = np.array([place for _, place in log.target])
    target = places[np.clip(np.searchsorted(since, at, side="right") - 1, 0, None)]
    zero = np.array([np.interp(0.0, truth[:, 0], truth[:, i]) for i in (1, 2)])
    initial = np.array([np.interp(0.0, estimate[:, 0], estimate[:, i]) for i in (1, 2)])
    off = there - true
    P = squares[known].reshape(-1, 2, 2, 2)  # instant, position or velocity, row, column
    far = np.column_stack([_mahalanobis(off[:, 2 * i : 2 * i + 2], P[:, i]) for i in (0, 1)])
    return Errors(
        t_ns=at,
        tracking_m=np.hypot(*(there[:, :2] - target).T),
        true_m=(true[:, :2] - zero) - (target - initial),
        outside=np.any(far > THREE_SIGMA, axis=1),
    )


def _mahalanobis(off: Array, P: Array) -> Array:
    """Compute off^T P^-1 off of each row, shapes (K, 2), (K, 2, 2); infinite where P is not a covariance."""
    det = P[:, 0, 0] * P[:, 1, 1] - P[:, 0, 1] * P[:, 1, 0]
    a, b = off.T
    square = P[:, 1, 1] * a * a - (P[:, 0, 1] + P[:, 1, 0]) * a * b + P[:, 0, 0] * b * b
    with np.errstate(all="ignore"):
        return np.where(det > 0, square / det, math.inf)


def judge(run_seed: int, place: Place, log: Log, cases: Sequence[Case], baseline: Errors | None) -> list[FaultOutcome]:
    """Judge each fault of a run. Without a baseline the error is not judged.

    The end of a run is attributed to one fault: the first with a late reaction, or else the last.
    """
    here = errors(log)
    seen = [_judged(run_seed, place, case, here, baseline) for case in cases]
    for case in cases[-1:]:
        seen[-1] = msgspec.structs.replace(seen[-1], false_figures=case.of.false_figures, wait_s=case.of.wait_s)
    late = [i for i, one in enumerate(seen) if one.uncontrolled and one.late]
    to_blame = late[0] if late else len(seen) - 1
    return [one if i == to_blame else msgspec.structs.replace(one, uncontrolled="") for i, one in enumerate(seen)]


def _judged(run_seed: int, place: Place, case: Case, here: Errors, baseline: Errors | None) -> FaultOutcome:
    fault, of = case.fault, case.of
    judged_ns = min(case.end_ns + AFTER_NS[1], of.until_ns)
    ended_here = bool(of.uncontrolled) and of.until_ns <= judged_ns
    reacted = reaction(case)
    within = (here.t_ns >= case.start_ns) & (here.t_ns <= judged_ns)
    off = here.true_m[within]
    measured = baseline is not None and not fault.permanent and not ended_here
    return FaultOutcome(
        fault=fault,
        place=place,
        run_seed=run_seed,
        harmed=case.harmed,
        reaction_s=reacted.seconds,
        late=reacted.late,
        worst_error_m=float(np.hypot(*off.T).max()) if within.any() else None,
        grown_m=float(np.hypot(*(off - off[0]).T).max()) if within.any() else None,
        bound_m=kinds.bound_m(fault),
        ratio=_ratio(case, here, baseline) if measured else None,
        outside_s=0.0 if baseline is None else _outside_s(case, here, baseline, judged_ns),
        uncounted=uncounted(case) + case.lost,
        bad_thrusts=sum(bad for t, bad, *_ in of.log.applied if case.start_ns <= t <= judged_ns),
        uncontrolled=of.uncontrolled if ended_here else "",
    )


def _ratio(case: Case, here: Errors, baseline: Errors) -> float:
    """Return the ratio of the tracking errors; infinite where nothing was measured after the fault."""
    first, last = (case.end_ns + after for after in AFTER_NS)
    after, usual = (
        float(of.tracking_m[within].mean()) if (within := (of.t_ns >= first) & (of.t_ns <= last)).any() else math.inf
        for of in (here, baseline)
    )
    return after / max(usual, float(baseline.tracking_m.mean()))


def _outside_s(case: Case, here: Errors, baseline: Errors, judged_ns: int) -> float:
    within = (here.t_ns >= case.start_ns) & (here.t_ns <= judged_ns) & here.outside
    anyway = set(baseline.t_ns[baseline.outside].tolist())
    reports = case.of.log.reports
    times = [report.t_ns for report in reports]
    plans = case.of.log.plans
    cycles = [plan.cycle_ns for plan in plans]
    silent = 0
    for t_ns in here.t_ns[within].tolist():
        if t_ns in anyway:
            continue
        first, last = bisect.bisect_left(times, t_ns - FLAG_NS), bisect.bisect_right(times, t_ns + FLAG_NS)
        said = any(not report.nominal or report.wrong for report in reports[first:last])
        plan = plans[min(bisect.bisect_left(cycles, t_ns), len(plans) - 1)]
        silent += not (said or plan.health is not Health.NOMINAL)
    return silent * float(np.median(np.diff(here.t_ns))) * 1e-9 if silent else 0.0
