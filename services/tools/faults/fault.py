"""Fault of the campaign and its observed outcome. This module does not depend on the simulation."""

from __future__ import annotations

import enum

import msgspec

RECOVERED = 2.0
"""Largest ratio of the mean tracking error after a fault to that without faults."""


class Place(enum.StrEnum):
    """Place of injection: in a lock-step run or in a run of processes."""

    LOCKSTEP = "lockstep"
    PROCESSES = "processes"


class Fault(msgspec.Struct, frozen=True, kw_only=True):
    """Fault to inject. Times are vehicle times (s); the meaning of ``size`` depends on the class (``kinds.py``)."""

    kind: str  # its class
    target: str
    start_s: float
    end_s: float
    size: float
    seed: int
    permanent: bool = False  # it lasts until the run's end, and no recovery is required


class FaultOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of one fault. None: it does not apply, or could not be observed."""

    fault: Fault
    place: Place
    run_seed: int
    harmed: int  # messages that it harmed
    reaction_s: float | None  # from when a reaction was due to the reaction
    late: str  # why the reaction was late; empty: it was in time
    worst_error_m: float | None  # true horizontal error until a minute after its end
    grown_m: float | None  # by how much that error moved, at most, from what it was at the start
    bound_m: float | None  # of ``grown_m``: where an instrument or a thruster is lost
    ratio: float | None  # mean tracking error 30 to 60 s after its end over that of the same seed without
    window_ratio: float | None  # the same over that in the same half minute alone
    outside_s: float  # the true error was outside 3 sigma and nothing flagged it
    uncounted: int  # messages harmed that nobody counted
    bad_thrusts: int  # commands not finite, or outside box or slew, in the plant's own record
    uncontrolled: str = ""  # how the run ended, where that was not to be
