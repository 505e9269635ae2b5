"""Result of a fault campaign: one row for each class, and the faults that violated a requirement."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import msgspec

from services.tools.faults.fault import RECOVERED, FaultOutcome, Place
from services.tools.faults.kinds import KINDS

UNFLAGGED_S = 10.0
"""Longest time (s) for which an error may be outside 3 sigma unflagged: one window of innovations."""


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one fault class. None: not measured."""

    fault: str
    limit: str  # of the reaction, in words
    injected: int
    in_processes: int
    reaction_median_s: float | None
    reaction_worst_s: float | None
    late: int
    worst_error_m: float | None
    worst_ratio: float | None
    not_recovered: int
    grown_m: float | None  # of what is lost: how far the true error moved at most,
    bound_m: float | None  # the largest bound of that,
    beyond_bound: int  # and how often the fault's own bound was exceeded
    unflagged: int  # longer than UNFLAGGED_S outside 3 sigma, and nothing flagged it
    uncounted: int
    bad_thrusts: int
    uncontrolled: int


class Campaign(msgspec.Struct, frozen=True, kw_only=True):
    """Content of faults.json."""

    seed: int
    quick: bool  # safety and reactions alone: what comes of the error later is not judged
    classes: int
    injected: int
    in_processes: int
    uncontrolled_exits: int
    bad_thrusts: int
    uncounted_losses: int
    late_reactions: int
    not_recovered: int
    window_over: int  # faults with a ``window_ratio`` over the same limit,
    window_asked: int  # of so many that have one,
    window_chance: float | None  # and the share of half minutes without any fault that are, by chance
    beyond_bound: int
    unflagged: int
    wall_s: float
    load: float  # of the machine over its last minute, for each core: what is asked by the wall needs one below 1
    rows: tuple[Row, ...]
    violations: tuple[FaultOutcome, ...]  # each fault for which a promise was not kept


def campaign(
    seen: Sequence[FaultOutcome],
    *,
    seed: int,
    quick: bool,
    wall_s: float,
    load: float,
    window_chance: float | None = None,
) -> Campaign:
    """Summarise the outcomes of all faults."""
    windows = [s.window_ratio for s in seen if s.window_ratio is not None]
    names = dict.fromkeys(kind.name for kind in KINDS)
    rows = tuple(row for name in names if (row := _row(name, [s for s in seen if s.fault.kind == name])).injected)
    return Campaign(
        seed=seed,
        quick=quick,
        classes=len(rows),
        injected=len(seen),
        in_processes=sum(row.in_processes for row in rows),
        uncontrolled_exits=sum(row.uncontrolled for row in rows),
        bad_thrusts=sum(row.bad_thrusts for row in rows),
        uncounted_losses=sum(row.uncounted for row in rows),
        late_reactions=sum(row.late for row in rows),
        not_recovered=sum(row.not_recovered for row in rows),
        window_over=sum(not ratio <= RECOVERED for ratio in windows),
        window_asked=len(windows),
        window_chance=window_chance,
        beyond_bound=sum(row.beyond_bound for row in rows),
        unflagged=sum(row.unflagged for row in rows),
        wall_s=wall_s,
        load=load,
        rows=rows,
        violations=tuple(s for s in seen if problems(s)),
    )


def problems(seen: FaultOutcome) -> list[str]:
    """List the requirements that were violated for this fault."""
    found = [seen.uncontrolled and f"ended: {seen.uncontrolled}", seen.late]
    found.append(f"{seen.bad_thrusts} bad thrusts" if seen.bad_thrusts else "")
    found.append(f"{seen.uncounted} uncounted messages" if seen.uncounted else "")
    found.append(
        f"tracking error {seen.ratio:.1f} times that of the run without the fault" if _not_recovered(seen) else ""
    )
    found.append(f"true error moved by {seen.grown_m:.1f} m, bound {seen.bound_m:g} m" if _beyond_bound(seen) else "")
    found.append(f"outside 3 sigma for {seen.outside_s:.0f} s, unflagged" if seen.outside_s > UNFLAGGED_S else "")
    return [text for text in found if text]


def _not_recovered(seen: FaultOutcome) -> bool:
    return seen.ratio is not None and not seen.ratio <= RECOVERED


def _beyond_bound(seen: FaultOutcome) -> bool:
    return seen.bound_m is not None and seen.grown_m is not None and not seen.grown_m <= seen.bound_m


def _row(name: str, seen: Sequence[FaultOutcome]) -> Row:
    took = sorted(s.reaction_s for s in seen if s.reaction_s is not None)
    return Row(
        fault=name,
        limit=next(kind.limit for kind in KINDS if kind.name == name),
        injected=len(seen),
        in_processes=sum(s.place is Place.PROCESSES for s in seen),
        reaction_median_s=took[len(took) // 2] if took else None,
        reaction_worst_s=took[-1] if took else None,
        late=sum(bool(s.late) for s in seen),
        worst_error_m=_worst(s.worst_error_m for s in seen),
        worst_ratio=_worst(s.ratio for s in seen),
        not_recovered=sum(_not_recovered(s) for s in seen),
        grown_m=_worst(s.grown_m for s in seen if s.bound_m is not None),
        bound_m=_worst(s.bound_m for s in seen),
        beyond_bound=sum(map(_beyond_bound, seen)),
        unflagged=sum(s.outside_s > UNFLAGGED_S for s in seen),
        uncounted=sum(s.uncounted for s in seen),
        bad_thrusts=sum(s.bad_thrusts for s in seen),
        uncontrolled=sum(bool(s.uncontrolled) for s in seen),
    )


def _worst(values: Iterable[float | None]) -> float | None:
    """Return the largest finite value (JSON has no infinity); None if there is none."""
    known = [value for value in values if value is not None and math.isfinite(value)]
    return max(known) if known else None


def kept(of: Campaign) -> bool:
    """Return True if every requirement was met."""
    return not of.violations
