"""Replay of a run, ``ltv-mpc replay RUN``: its nodes step again on their recorded inputs, and outputs are compared.

Nodes are independent of one another, so each can be replayed alone. On two cores, estimator and controller run in one
process and the simulated world in another; each is half of the work. On three, the estimator, which has the most work,
has a process of its own. Memory does not grow with the length of a run: each process reads the file once and keeps a
bounded part of it (``epoch.REACH``).
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from functools import partial
from pathlib import Path

import msgspec

from ltv_mpc.control.node import ControllerNode
from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.estimator import Estimator
from services.recording.reader import Recording
from services.recording.recover import segments
from services.replay import nodes
from services.replay.comparison import Comparison
from services.replay.node_replay import NodeReplay, feed
from services.replay.verdict import MAX_GAPS, NodeVerdict, ProvenanceDifference, Verdict, WhatIfVerdict, first
from services.replay.what_if import WhatIf
from services.run.host_resources import core_count
from services.run.provenance import provenance_table
from services.run.run_config import ORIGIN

MIN_PARALLEL_BYTES = 2_000_000
"""Smallest file that is replayed by several processes. A process may take a second to start."""

PROCESS_GROUPS: Mapping[int, tuple[tuple[str, ...], ...]] = {
    2: ((Estimator.name, ControllerNode.name),),
    3: ((Estimator.name,), (ControllerNode.name,)),
}
"""Nodes that share a process of their own, by number of cores. The calling process replays all others."""

Progress = Callable[[int], None]
"""Callback that receives the vehicle time that the replay has reached."""


class Run:
    """Recording and the nodes in it. Raises ``ConfigError`` if it has no valid settings of any node."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.parts = segments(path)
        self.metadata = metadata_of(path)
        self.nodes = nodes.nodes_of(self.recordings(), self.metadata, source=f"recording {path}")
        self.names = self.nodes.names

    def recordings(self) -> list[Recording]:
        """Return the file and the segments that restarted recorders have left beside it."""
        return [Recording(part) for part in self.parts]

    def only(self, node: str | None) -> tuple[str, ...]:
        """Return the node ``node``, or all for None. Raises ``ConfigError`` if the run does not have it."""
        if node is None:
            return self.names
        if node not in self.names:
            raise ConfigError("option --node", "", f"must be one of {', '.join(self.names)}", value=node)
        return (node,)


def metadata_of(path: Path) -> Mapping[str, str]:
    """Return the metadata of a recording. Raises ``ConfigError`` if it is not a recording."""
    recording = Recording(path)
    next(recording.stored(), None)
    return recording.metadata


# --- every output again ----------------------------------------------------------------------------------------------


def replay(run: Run, *, only: str | None = None, progress: Progress = lambda _: None) -> Verdict:
    """Replay every step that can be replayed, and compare its outputs. Raises ``ConfigError``."""
    names = run.only(only)
    started_s = time.monotonic()
    here, *others = _groups(run, names)
    if not others:
        done = [_compared(run, here, progress)]
    else:
        with ProcessPoolExecutor(len(others), mp_context=multiprocessing.get_context(_start_method())) as pool:
            futures: list[Future[_Done]] = [pool.submit(_compared_alone, run.path, group) for group in others]
            done = [_compared(run, here, progress), *(future.result() for future in futures)]
    wall_s = time.monotonic() - started_s
    verdicts = sorted((node for part in done for node in part.nodes), key=lambda verdict: names.index(verdict.node))
    return _verdict(run, tuple(verdicts), done, wall_s)


def _start_method() -> str:
    """Return "fork" for a process with one thread: its child has everything loaded. Other threads might hold locks."""
    try:
        return "fork" if len(os.listdir("/proc/self/task")) == 1 else "spawn"
    except OSError:  # not Linux
        return "spawn"


class _Done(msgspec.Struct, frozen=True):
    """Result of one process."""

    nodes: tuple[NodeVerdict, ...]
    cut: bool
    start_ns: int
    end_ns: int


def _groups(run: Run, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the nodes that each process replays, those of the calling process first."""
    cores = core_count()
    if cores < min(PROCESS_GROUPS) or sum(part.stat().st_size for part in run.parts) <= MIN_PARALLEL_BYTES:
        return [tuple(names)]
    aboard = PROCESS_GROUPS[min(cores, max(PROCESS_GROUPS))]
    rest = tuple(name for name in names if not any(name in group for group in aboard))
    shares = (rest, *(tuple(name for name in group if name in names) for group in aboard))
    return [share for share in shares if share]


def _compared_alone(path: Path, names: tuple[str, ...]) -> _Done:
    """Replay in a process of its own, which reads the settings from the recording."""
    return _compared(Run(path), names, lambda _: None)


def _compared(run: Run, names: Sequence[str], progress: Progress) -> _Done:
    span_ns: list[int] = []

    def advance(t_ns: int) -> None:
        span_ns[:] = min((t_ns, *span_ns)), max((t_ns, *span_ns))
        progress(t_ns)

    parts = [NodeReplay(name, partial(run.nodes.make, name), partial(Comparison, name)) for name in names]
    recordings = run.recordings()
    feed(recordings, parts, progress=advance)
    return _Done(tuple(map(_node_verdict, parts)), any(recording.cut for recording in recordings), *(span_ns or (0, 0)))


def _node_verdict(part: NodeReplay) -> NodeVerdict:
    counts = [epoch.outcome for epoch in part.epochs.values() if isinstance(epoch.outcome, Comparison)]
    gaps = [epoch.gap for epoch in part.epochs.values() if epoch.gap is not None]
    return NodeVerdict(
        node=part.name,
        starts=len(part.epochs),
        steps_run=sum(epoch.steps_run for epoch in part.epochs.values()),
        steps_compared=sum(count.compared for count in counts),
        steps_identical=sum(count.identical for count in counts),
        outputs_compared=sum(count.outputs_compared for count in counts),
        outputs_lost=sum(count.outputs_lost for count in counts),
        outputs_unpublished=sum(count.outputs_unpublished for count in counts),
        gaps=tuple(gaps[:MAX_GAPS]),
        more_gaps=max(0, len(gaps) - MAX_GAPS),
        first_difference=first([count.first_difference for count in counts]),
    )


def _verdict(run: Run, verdicts: tuple[NodeVerdict, ...], done: Sequence[_Done], wall_s: float) -> Verdict:
    vehicle_s = (max(part.end_ns for part in done) - min(part.start_ns for part in done)) / 1e9
    compared = sum(verdict.steps_compared for verdict in verdicts)
    identical = sum(verdict.steps_identical for verdict in verdicts)
    difference = first([verdict.first_difference for verdict in verdicts])
    return Verdict(
        recording=str(run.path),
        scenario=run.nodes.title,
        mode=run.metadata.get("mode", ""),
        cut=any(part.cut for part in done),
        vehicle_s=vehicle_s,
        wall_s=wall_s,
        times_real_time=vehicle_s / wall_s,
        identical=0 < compared == identical and difference is None,
        steps_run=sum(verdict.steps_run for verdict in verdicts),
        steps_compared=compared,
        steps_identical=identical,
        nodes=verdicts,
        first_difference=difference,
        provenance_differences=provenance_differences(run.nodes.made_by),
    )


# --- what another setting would have done ----------------------------------------------------------------------------


def what_if(run: Run, settings: Path, *, only: str | None = None, progress: Progress = lambda _: None) -> WhatIfVerdict:
    """Replay the node whose settings the file has, with these settings. Raises ``ConfigError``."""
    name, other, changes = nodes.replaced(run.nodes, settings)
    if only not in (None, name):
        problem = f"cannot act together with --with {settings}, which holds settings of the {name}"
        raise ConfigError("option --node", "", problem, value=only)
    started_s = time.monotonic()
    comparison = WhatIf(name)
    part = NodeReplay(name, partial(other.make, name), lambda _: comparison)
    feed(run.recordings(), [part], progress=progress)
    return WhatIfVerdict(
        recording=str(run.path),
        scenario=run.nodes.title,
        settings=str(settings),
        node=name,
        changes=changes,
        steps_run=sum(epoch.steps_run for epoch in part.epochs.values()),
        steps_replayed=comparison.steps,
        recorded=comparison.recorded.total(),
        replayed=comparison.replayed.total(),
        pairs=comparison.pairs,
        deviations=comparison.deviations,
        shares=comparison.shares,
        wall_s=time.monotonic() - started_s,
        provenance_differences=provenance_differences(run.nodes.made_by),
    )


ABSENT = "not recorded"


def provenance_differences(made: Mapping[str, str] | None) -> tuple[ProvenanceDifference, ...]:
    """Return each entry of a run's [made_by] that differs on this machine.

    On another processor the last bits of a product or a sine may differ, and so may every later output.
    """
    run, here = dict(made or {}), provenance_table()
    run.pop(ORIGIN, None)
    return tuple(
        ProvenanceDifference(what=name, run=run.get(name, ABSENT), here=here.get(name, ABSENT))
        for name in {**here, **run}
        if run.get(name, ABSENT) != here.get(name, ABSENT)
    )
