"""Random draw of the faults of a campaign: class, target, time, duration and size as a function of the seed.

Faults are assigned to classes in turn and to targets in turn, so that n of them are spread evenly. Times, durations and
sizes are random. A run has several faults in sequence: each starts a minute after the end of the one before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.faults.kinds import AFLOAT, Fault, FaultClass

LAST_S = 75.0
"""Time from the start of a permanent fault to the end of the run."""

PERMANENT = 0.3
"""Share of permanent faults among those that may be permanent."""

AFLOAT_S = (-24.0, -16.0)
"""Start of a fault of a sensor that works at the surface only; it ends before the descent."""


class Pace(NamedTuple):
    """Timing of the faults in a run (s): time afloat, start of the first fault under water, minimum pause after a
    fault, maximum duration of a fault, and maximum random addition to the pause.
    """

    afloat_s: float
    first_s: float
    after_s: float
    longest_s: float = math.inf
    pause_s: float = 3.0

    def targets(self, kind: FaultClass) -> Sequence[str]:
        """List the targets of a class. GNSS and TDCP are left out if the vehicle is not afloat long enough."""
        return [target for target in kind.targets if target not in AFLOAT or self.afloat_s > -AFLOAT_S[0]]


class Run(msgspec.Struct, frozen=True, kw_only=True):
    """Run of the campaign: scenario seed, faults in order of time, duration, and time afloat before the descent."""

    seed: int
    faults: tuple[Fault, ...]
    duration_s: float
    afloat_s: float = 30.0


def runs(kinds: Sequence[FaultClass], n: int, *, seed: int, several: int, seeds: int, pace: Pace) -> list[Run]:
    """Draw ``n`` faults of these classes and distribute them over runs of ``several``, which use ``seeds`` scenario
    seeds.
    """
    rng = np.random.default_rng([seed, len(kinds), n])
    # Each class begins with another of its targets, so that few faults of many classes meet all targets.
    drawn = [_drawn(kinds[i % len(kinds)], i // len(kinds) + i % len(kinds), rng, pace) for i in range(n)]
    order = rng.permutation(n)
    afloat = [drawn[i] for i in order if drawn[i].target in AFLOAT]
    lasting = [drawn[i] for i in order if _lasts(drawn[i], pace)]
    others = [drawn[i] for i in order if not _lasts(drawn[i], pace) and drawn[i].target not in AFLOAT]
    others.sort(key=lambda fault: fault.kind != "reference_point")  # its alarm outlasts it: at most one in a run
    count = max(math.ceil(n / several), len(afloat), len(lasting))
    # Dealt in turn: at most one of each that must come first or last in a run.
    return [
        _run(seed * 1000 + i % seeds, [*afloat[i::count], *others[i::count], *lasting[i::count]], rng, pace)
        for i in range(count)
    ]


def _lasts(fault: Fault, pace: Pace) -> bool:
    """Return True if the fault must be the last of its run, because its effect on the estimate would count against
    later ones, or because its process stays stopped.
    """
    return fault.permanent or fault.kind == "helper_stopped" or (fault.target == "imu" and math.isinf(pace.longest_s))


def _drawn(kind: FaultClass, turn: int, rng: np.random.Generator, pace: Pace) -> Fault:
    targets = pace.targets(kind)
    target = targets[turn % len(targets)]
    low, high = kind.size
    size = float(rng.uniform(low, high))
    if low < 0:  # either way, small ones as likely as large ones
        size = math.copysign(math.exp(rng.uniform(math.log(0.3), math.log(high))), size)
    duration_s = min(float(rng.uniform(*kind.duration_s)), pace.longest_s)
    if target in AFLOAT:
        duration_s = min(duration_s, -AFLOAT_S[1] - 1.0)
    return Fault(
        kind=kind.name,
        target=target,
        start_s=0.0,
        end_s=duration_s,
        size=size,
        seed=int(rng.integers(2**31)),
        permanent=kind.may_last
        and target not in AFLOAT
        and math.isinf(pace.longest_s)
        and bool(rng.random() < PERMANENT),
    )


def _run(seed: int, faults: Sequence[Fault], rng: np.random.Generator, pace: Pace) -> Run:
    placed = []
    next_s = pace.first_s
    for fault in faults:
        start_s = (
            float(rng.uniform(*AFLOAT_S)) if fault.target in AFLOAT else next_s + float(rng.uniform(0, pace.pause_s))
        )
        end_s = start_s + (LAST_S if fault.permanent else fault.end_s)
        placed.append(msgspec.structs.replace(fault, start_s=start_s, end_s=end_s))
        if fault.target not in AFLOAT:
            next_s = end_s if fault.permanent else end_s + pace.after_s
    duration_s = max(next_s, pace.first_s + pace.after_s)
    return Run(seed=seed, faults=tuple(placed), duration_s=duration_s, afloat_s=pace.afloat_s)
