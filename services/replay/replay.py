"""Replay of a run, ``ltv-mpc replay RUN``: its nodes step again on their recorded inputs, and outputs are compared.

Memory does not grow with the length of a run: the file is read once, and a bounded part of it is kept
(``REACH`` and ``MAX_FRAMES`` of ``node_replay``).
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

from ltv_mpc.errors import ConfigError
from services.replay.comparison import Comparison
from services.replay.node_replay import NodeReplay, feed
from services.replay.nodes import Run, node_of
from services.replay.verdict import MAX_GAPS, Difference, NodeVerdict, ProvenanceDifference, Verdict, WhatIfVerdict
from services.replay.what_if import WhatIf
from services.run.provenance import provenance_table
from services.run.run_config import ORIGIN

# --- every output again ----------------------------------------------------------------------------------------------


def replay(run: Run, *, only: str | None = None) -> Verdict:
    """Replay every step that can be replayed, and compare its outputs. Raises ``ConfigError``."""
    started_s = time.monotonic()
    parts = [NodeReplay(name, partial(run.make, name), partial(Comparison, name)) for name in run.only(only)]
    recording = run.recording()
    vehicle_s = feed(recording, parts)
    verdicts, wall_s = tuple(map(_node_verdict, parts)), time.monotonic() - started_s
    compared = sum(verdict.steps_compared for verdict in verdicts)
    identical = sum(verdict.steps_identical for verdict in verdicts)
    difference = _first(verdict.first_difference for verdict in verdicts)
    return Verdict(
        recording=str(run.path),
        scenario=run.title,
        mode=run.metadata.get("mode", ""),
        cut=recording.cut,
        vehicle_s=vehicle_s,
        wall_s=wall_s,
        times_real_time=vehicle_s / wall_s,
        identical=0 < compared == identical and difference is None,
        steps_run=sum(verdict.steps_run for verdict in verdicts),
        steps_compared=compared,
        steps_identical=identical,
        nodes=verdicts,
        first_difference=difference,
        provenance_differences=provenance_differences(run.made_by),
    )


def _node_verdict(part: NodeReplay) -> NodeVerdict:
    counts = [epoch.outcome for epoch in part.epochs.values() if isinstance(epoch.outcome, Comparison)]
    outputs = sum((count.outputs for count in counts), Counter[str]())
    gaps = [epoch.gap for epoch in part.epochs.values() if epoch.gap is not None]
    return NodeVerdict(
        node=part.name,
        starts=len(part.epochs),
        steps_run=sum(epoch.steps_run for epoch in part.epochs.values()),
        steps_compared=sum(count.compared for count in counts),
        steps_identical=sum(count.identical for count in counts),
        outputs_compared=outputs["compared"],
        outputs_lost=outputs["lost"],
        outputs_unpublished=outputs["unpublished"],
        gaps=tuple(gaps[:MAX_GAPS]),
        more_gaps=max(0, len(gaps) - MAX_GAPS),
        first_difference=_first(count.first_difference for count in counts),
    )


def _first(differences: Iterable[Difference | None]) -> Difference | None:
    """Return the earliest difference in vehicle time; None if there is none."""
    present = (difference for difference in differences if difference is not None)
    return min(present, key=lambda difference: difference.t_ns, default=None)


# --- what another setting would have done ----------------------------------------------------------------------------


def what_if(run: Run, settings: Path, *, only: str | None = None) -> WhatIfVerdict:
    """Replay the node whose settings the file has, with these settings. Raises ``ConfigError``."""
    name = node_of(settings)
    changes = run.changes(name, settings)
    if only not in (None, name):
        problem = f"cannot act together with --with {settings}, which holds settings of the {name}"
        raise ConfigError("option --node", "", problem, value=only)
    started_s = time.monotonic()
    comparison = WhatIf(name)
    part = NodeReplay(name, partial(run.make, name, settings=settings), lambda _: comparison)
    feed(run.recording(), [part])
    return WhatIfVerdict(
        recording=str(run.path),
        scenario=run.title,
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
        provenance_differences=provenance_differences(run.made_by),
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
