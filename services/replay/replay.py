"""``ltv-mpc replay RUN``: the nodes of a run fed again what they were fed, and what came of it.

Nodes know nothing of one another, so each can be replayed alone: on two cores what is aboard has one for itself, and
the simulated world the other; each is half of the work. On three the estimator, which has most to do, has one of its
own. Memory does not grow with the length of a run: a process reads the file once, and what is kept of it is bounded
(``epoch.REACH``).
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
from services.replay.provenance_differences import elsewhere
from services.replay.verdict import MAX_GAPS, NodeVerdict, Verdict, WhatIfVerdict, first
from services.replay.what_if import WhatIf
from services.run.host_resources import core_count

WORTH_A_PROCESS_BYTES = 2_000_000
"""A second process may take a second to start: for a file that is read faster than that it is not worth it."""

TOGETHER: Mapping[int, tuple[tuple[str, ...], ...]] = {
    2: ((Estimator.name, ControllerNode.name),),
    3: ((Estimator.name,), (ControllerNode.name,)),
}
"""By the number of cores: nodes that have a process of their own. All others are replayed by the caller's."""

Progress = Callable[[int], None]
"""Progress the vehicle time that was reached."""


class Run:
    """A recording and what it says that the run was made of. Raises ``ConfigError`` where it says nothing usable."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.parts = segments(path)
        self.metadata = metadata_of(path)
        self.run_config = nodes.run_config_of(self.metadata, source=f"recording {path}")
        self.names = nodes.names(self.run_config)

    def recordings(self) -> list[Recording]:
        """The file, and the segments that restarted recorders left beside it."""
        return [Recording(part) for part in self.parts]

    def only(self, node: str | None) -> tuple[str, ...]:
        """The nodes that are asked for; None: all. Raises ``ConfigError`` for one that the run does not have."""
        if node is None:
            return self.names
        if node not in self.names:
            raise ConfigError("option --node", "", f"must be one of {', '.join(self.names)}", value=node)
        return (node,)


def metadata_of(path: Path) -> Mapping[str, str]:
    """What the head of a recording says. Raises ``ConfigError`` where it is none."""
    recording = Recording(path)
    next(recording.stored(), None)
    return recording.metadata


# --- every output again ----------------------------------------------------------------------------------------------


def replay(run: Run, *, only: str | None = None, progress: Progress = lambda _: None) -> Verdict:
    """Compare every step that can be. Raises ``ConfigError``."""
    names = run.only(only)
    began = time.monotonic()
    apart = _apart(run, names)
    here = tuple(name for name in names if not any(name in group for group in apart))
    if not apart:
        done = _compared(run, here, progress)
    else:
        with ProcessPoolExecutor(len(apart), mp_context=multiprocessing.get_context(_way())) as pool:
            theirs: list[Future[_Done]] = [pool.submit(_compared_alone, run.path, group) for group in apart]
            done = _compared(run, here, progress)
            for others in theirs:
                done = done.with_(others.result())
    wall_s = time.monotonic() - began
    verdicts = tuple(sorted(done.nodes, key=lambda verdict: names.index(verdict.node)))
    return _verdict(run, verdicts, done, wall_s)


def _way() -> str:
    """Forked from a process of one thread, another has all loaded; of several, some may hold a lock for ever."""
    try:
        return "fork" if len(os.listdir("/proc/self/task")) == 1 else "spawn"
    except OSError:  # not Linux
        return "spawn"


class _Done(msgspec.Struct, frozen=True):
    """What one process has replayed."""

    nodes: tuple[NodeVerdict, ...]
    cut: bool
    since_ns: int
    until_ns: int

    def with_(self, other: _Done) -> _Done:
        """Both."""
        since_ns, until_ns = min(self.since_ns, other.since_ns), max(self.until_ns, other.until_ns)
        return _Done(self.nodes + other.nodes, self.cut or other.cut, since_ns, until_ns)


def _apart(run: Run, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Nodes that are better done by other processes at the same time."""
    size = sum(part.stat().st_size for part in run.parts)
    cores = core_count()
    if cores < min(TOGETHER) or size <= WORTH_A_PROCESS_BYTES:
        return []
    groups = [tuple(name for name in group if name in names) for group in TOGETHER[min(cores, max(TOGETHER))]]
    there = [group for group in groups if group]
    return there if sum(map(len, there)) < len(names) else there[1:]


def _compared_alone(path: Path, names: tuple[str, ...]) -> _Done:
    """In a process of its own: settings are read anew, they need not travel."""
    return _compared(Run(path), names, lambda _: None)


def _compared(run: Run, names: Sequence[str], progress: Progress) -> _Done:
    span_ns: list[int] = []

    def told(t_ns: int) -> None:
        span_ns[:] = min((t_ns, *span_ns)), max((t_ns, *span_ns))
        progress(t_ns)

    parts = [NodeReplay(name, partial(nodes.make, run.run_config, name), partial(Comparison, name)) for name in names]
    recordings = run.recordings()
    feed(recordings, parts, progress=told)
    return _Done(tuple(map(_of_node, parts)), any(recording.cut for recording in recordings), *(span_ns or (0, 0)))


def _of_node(part: NodeReplay[Comparison]) -> NodeVerdict:
    outcomes = list(part.outcomes.values())
    gaps = [epoch.gap for epoch in part.epochs.values() if epoch.gap is not None]
    return NodeVerdict(
        node=part.name,
        starts=len(part.epochs),
        steps_run=sum(epoch.steps_run for epoch in part.epochs.values()),
        steps_compared=sum(outcome.steps_compared for outcome in outcomes),
        steps_identical=sum(outcome.steps_identical for outcome in outcomes),
        outputs_compared=sum(outcome.compared for outcome in outcomes),
        outputs_lost=sum(outcome.lost for outcome in outcomes),
        outputs_unpublished=sum(outcome.unpublished for outcome in outcomes),
        gaps=tuple(gaps[:MAX_GAPS]),
        more_gaps=max(0, len(gaps) - MAX_GAPS),
        first_difference=first([outcome.first_difference for outcome in outcomes]),
    )


def _verdict(run: Run, verdicts: tuple[NodeVerdict, ...], done: _Done, wall_s: float) -> Verdict:
    scenario = run.run_config.scenario
    vehicle_s = (done.until_ns - done.since_ns) / 1e9
    compared = sum(verdict.steps_compared for verdict in verdicts)
    identical = sum(verdict.steps_identical for verdict in verdicts)
    difference = first([verdict.first_difference for verdict in verdicts])
    return Verdict(
        recording=str(run.path),
        scenario=run.run_config.name,
        mode=run.metadata.get("mode", ""),
        cut=done.cut,
        vehicle_s=vehicle_s,
        wall_s=wall_s,
        times_real_time=vehicle_s / wall_s,
        identical=0 < compared == identical and difference is None,
        steps_run=sum(verdict.steps_run for verdict in verdicts),
        steps_compared=compared,
        steps_identical=identical,
        nodes=verdicts,
        first_difference=difference,
        elsewhere=elsewhere(scenario.made_by),
    )


# --- what another setting would have done ----------------------------------------------------------------------------


def what_if(run: Run, settings: Path, *, only: str | None = None, progress: Progress = lambda _: None) -> WhatIfVerdict:
    """Replay the node whose settings the file holds. Raises ``ConfigError``."""
    name, other, changes = nodes.replaced(run.run_config, settings)
    if only not in (None, name):
        problem = f"cannot act together with --with {settings}, which holds settings of the {name}"
        raise ConfigError("option --node", "", problem, value=only)
    began = time.monotonic()
    whole = WhatIf(name)
    part = NodeReplay(name, partial(nodes.make, other, name), whole.epoch_outcome)
    feed(run.recordings(), [part], progress=progress)
    return WhatIfVerdict(
        recording=str(run.path),
        scenario=run.run_config.name,
        settings=str(settings),
        node=name,
        changes=changes,
        steps_run=sum(epoch.steps_run for epoch in part.epochs.values()),
        steps_replayed=whole.steps,
        recorded=whole.recorded.total(),
        replayed=whole.replayed.total(),
        pairs=whole.pairs,
        deviations=whole.deviations,
        shares=whole.shares,
        wall_s=time.monotonic() - began,
        elsewhere=elsewhere(run.run_config.scenario.made_by),
    )
