"""Verdict on a run of processes, from its recording and the injected faults."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import msgspec

from ltv_mpc.vehicle.parameters import Vehicle
from services.recording.loss_accounting import LossAccounting
from services.tools.faults import recorded
from services.tools.faults.attacks import ENDING
from services.tools.faults.draw import Run
from services.tools.faults.fault import Fault, FaultOutcome, Place
from services.tools.faults.judge import Errors, blamed, errors, judged
from services.tools.faults.lockstep_runs import Observed
from services.tools.faults.process_runs import Injected
from services.tools.faults.reactions import Case, Reaction
from services.tools.faults.recorded import ESTIMATE, PLAN, TRUTH, Recorded, Taken

BACK_S = 2.0
"""Longest wall time from the end of a process to the first accepted message of its successor."""

OUTAGE_US = 60_000
"""Shortest gap in the recording that counts as an outage; the plant publishes every 5 ms at twice real time."""

MAX_OUTAGE_US = 10_000_000

RECORDER = "recorder"

READ_BY = {"estimate": "controller", "applied": "controller", "plan": "plant"}
"""Reader of each key whose messages are harmed between processes."""


class OfProcesses(NamedTuple):
    """Run of processes that has ended. ``uncontrolled``: how, if it did not end as expected."""

    run: Run
    folder: Path
    injected: Sequence[Injected]
    harmed: Sequence[int]  # messages, by fault
    uncontrolled: str


def judge(of: OfProcesses, vehicle: Vehicle, baseline: Errors | None) -> list[FaultOutcome]:
    """Judge each fault that was injected."""
    if not (of.folder / "run.mcap").exists():
        return blamed([_nothing(of, one.fault) for one in of.injected])
    read = recorded.read(of.folder / "run.mcap", vehicle)
    here = errors(read.log)
    lost = max(0, _lost(read) - _counted(read, of.folder) - read.unreadable)
    seen = []
    for place, one in enumerate(of.injected):
        fault = one.fault
        harmed = of.harmed[place] if place < len(of.harmed) else 0
        case = Case(
            fault=fault,
            start_ns=one.at_ns,
            end_ns=max(one.at_ns, round(fault.end_s * 1e9)),
            harmed=harmed,
            of=Observed(
                log=read.log,
                harmed={},
                accepted=None,
                dropped=_dropped(read, READ_BY.get(fault.target, "")),
                uncontrolled=of.uncontrolled,
                until_ns=read.until_ns,
                lost_plans=min(harmed, _holes(read, PLAN)) if fault.target == PLAN else 0,
            ),
            back=_back(read, one),
        )
        found = judged(of.run.seed, case, here, baseline, Place.PROCESSES)
        seen.append(msgspec.structs.replace(found, uncounted=found.uncounted + (0 if place else lost)))
    return blamed(seen)


def _nothing(of: OfProcesses, fault: Fault) -> FaultOutcome:
    return FaultOutcome(
        fault=fault,
        place=Place.PROCESSES,
        run_seed=of.run.seed,
        harmed=0,
        reaction_s=None,
        late="",
        worst_error_m=None,
        grown_m=None,
        bound_m=None,
        ratio=None,
        window_ratio=None,
        outside_s=0.0,
        uncounted=0,
        bad_thrusts=0,
        uncontrolled=of.uncontrolled or "there is no recording",
    )


def _back(read: Recorded, one: Injected) -> Reaction | None:
    """Return the outage of a process that was killed or stopped for good; None for other faults."""
    if one.why:
        return Reaction(None, f"not injected: {one.why}")
    if one.fault.kind not in ENDING:
        return None
    if (at_us := _again(read, one)) is None:
        return Reaction(None, "did not recover")
    seconds = (at_us - one.at_us) * 1e-6
    return Reaction(seconds, f"recovered after {seconds:.2f} s" if seconds > BACK_S else "")


def _again(read: Recorded, one: Injected) -> int | None:
    """Return when the process was back (monotonic, us).

    Estimator and controller: the first message of a new start that its reader took. Recorder and router: the plant's
    first word that is recorded again.
    """
    key = {"estimator": ESTIMATE, "controller": PLAN}.get(one.fault.target)
    if key is None:
        truth_us = sorted(sent.at_us for sent in read.sent if sent.key == TRUTH)
        ends = [b for a, b in pairwise(truth_us) if b - a > OUTAGE_US and b > one.at_us]
        if not truth_us or truth_us[-1] < one.at_us:
            return None
        return next((b for b in ends if b < one.at_us + MAX_OUTAGE_US), one.at_us)
    before = {sent.epoch for sent in read.sent if sent.key == key and sent.at_us <= one.at_us}
    after = (sent for sent in read.sent if sent.key == key and sent.at_us > one.at_us and sent.epoch not in before)
    return next((sent.at_us for sent in after if Taken(key, sent.epoch, sent.sequence) in read.taken), None)


def _lost(read: Recorded) -> int:
    """Count the messages that were published and are not in the recording, of processes that report their number."""
    return sum(max(0, status.published - read.messages[epoch]) for epoch, status in read.last.items())


def _holes(read: Recorded, key: str) -> int:
    """Count the missing sequence numbers of a key between the first and the last recorded one of each epoch."""
    losses = LossAccounting()
    for epoch, sequence in sorted((sent.epoch, sent.sequence) for sent in read.sent if sent.key == key):
        losses.start_at(key, epoch, sequence)
        losses.add(key, epoch, sequence)
    return losses.missing


def _counted(read: Recorded, folder: Path) -> int:
    """Return how many lost messages the recorder's last status or the run's summary reports."""
    counts = [status.dropped for status in read.statuses if status.node == RECORDER][-1:]
    try:
        summary = msgspec.json.decode((folder / "summary.json").read_bytes())
        counts.append(int(summary["messages"]["dropped"]))
    except (OSError, ValueError, KeyError, TypeError, msgspec.MsgspecError):
        pass  # a run that did not come to its end has none
    return max(counts, default=0)


def _dropped(read: Recorded, node: str) -> list[tuple[int, int]]:
    """Return the number of messages that a reader counts as lost, over time."""
    return [(-(10**18), 0), *((status.t_ns, status.dropped) for status in read.statuses if status.node == node)]
