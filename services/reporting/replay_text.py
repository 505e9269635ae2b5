"""Text output of ``ltv-mpc replay``, for a terminal of at least 80 columns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import msgspec

from services.replay.verdict import Difference, NodeVerdict, ProvenanceDifference, Verdict, WhatIfVerdict
from services.runtime.console import columns

MAX_VALUE_LENGTH = 32
MODES = {"lockstep": "in lock step", "services": "as processes", "vehicle": "beside a vehicle"}
NODE_FIGURES = "node", "starts", "steps run", "compared", "identical", "outputs"
SAME_MACHINE_NEEDED = "another processor or version may change the last bits, and all outputs that follow:"


def text(verdict: Verdict) -> str:
    """Format the result of a replay, without a line break at the end."""
    compared, run = verdict.steps_compared, verdict.steps_run
    lines = [
        f"run           {verdict.scenario}, {verdict.vehicle_s:.1f} s {MODES.get(verdict.mode, verdict.mode)}",
        *columns([NODE_FIGURES, *map(_cells, verdict.nodes)], numbers=True),
        "",
        f"compared      {_share(compared, run)} of {run} steps",
        f"identical     {_share(verdict.steps_identical, compared)} of {compared} steps, byte for byte",
        *_losses(verdict),
        *_difference(verdict.first_difference),
        *_provenance_differences(verdict.provenance_differences),
        f"took          {verdict.wall_s:.1f} s, {verdict.times_real_time:.0f} times real time",
        "",
        verdict.recording,
    ]
    return "\n".join(lines)


def what_if_text(verdict: WhatIfVerdict) -> str:
    """Format the result of a replay with other settings (``--with``)."""
    node = verdict.node
    changes = [f"{change.key} = {_value(change.here)}, in the run {_value(change.run)}" for change in verdict.changes]
    what = "estimates of one time" if verdict.node == "estimator" else "plans of one cycle, at the recorded one's knots"
    lines = [
        f"run           {verdict.scenario}, its {node} with {verdict.settings}",
        *_labelled("changed", changes or ["nothing: the settings are the run's own"]),
        f"replayed      {verdict.steps_replayed} of {verdict.steps_run} steps, the inputs as recorded",
        f"compared      {verdict.pairs} {what}",
    ]
    if verdict.deviations:
        head = "replayed - recorded", "rms", "largest", "last"
        rows = [
            (f"{d.of} ({d.unit})", f"{d.rms:.4g}", f"{d.max_abs:.4g}", f"{d.final:+.4g}") for d in verdict.deviations
        ]
        lines += ["", *columns([head, *rows], numbers=True)]
    if verdict.shares:
        shares = [(one.origin, f"{100 * one.recorded:.1f} %", f"{100 * one.replayed:.1f} %") for one in verdict.shares]
        lines += ["", *columns([("plans", "recorded", "replayed"), *shares], numbers=True)]
    lines += ["", *_provenance_differences(verdict.provenance_differences), verdict.recording]
    return "\n".join(lines)


def _cells(node: NodeVerdict) -> tuple[str, ...]:
    counts = node.starts, node.steps_run, node.steps_compared, node.steps_identical, node.outputs_compared
    return node.node, *map(str, counts)


def _losses(verdict: Verdict) -> Iterator[str]:
    losses = ["the recording is cut off"] if verdict.cut else []
    for node in verdict.nodes:
        for gap in node.gaps:
            since = "" if gap.t_ns is None else f" from {gap.t_ns / 1e9:.2f} s on"
            losses.append(f"{node.node}: {gap.steps} steps{since} not replayed: {gap.why}")
        if node.more_gaps:
            losses.append(f"{node.node}: and {node.more_gaps} more gaps")
        if node.outputs_lost:
            losses.append(f"{node.node}: {node.outputs_lost} outputs are not in the file")
        if node.outputs_unpublished:
            losses.append(f"{node.node}: {node.outputs_unpublished} outputs were computed but not published at its end")
    yield from _labelled("missing", losses)


def _difference(difference: Difference | None) -> Iterator[str]:
    if difference is None:
        return
    what = f"{difference.key} {difference.sequence}" if difference.key else difference.what
    yield f"first differs {difference.node}, step {difference.step} at {difference.t_ns / 1e9:.3f} s: {what}"
    if difference.key and difference.what:
        yield f"              {difference.what}"
    for field in difference.fields:
        recorded = f"recorded {_value(field.recorded)}"
        yield f"    {field.path:<26} {recorded:<{MAX_VALUE_LENGTH + 10}} replayed {_value(field.replayed)}"
    if difference.more_fields:
        yield f"    and {difference.more_fields} more fields"


def _provenance_differences(differing: Iterable[ProvenanceDifference]) -> Iterator[str]:
    lines = [f"{entry.what}: the run {entry.run}, here {entry.here}" for entry in differing]
    yield from _labelled("differs", [SAME_MACHINE_NEEDED, *lines] if lines else [])


def _labelled(label: str, lines: Iterable[str]) -> Iterator[str]:
    for i, line in enumerate(lines):
        yield f"{'' if i else label:<13} {line}"


def _share(part: int, whole: int) -> str:
    """Format a share in percent, never rounded up to 100 %."""
    if part == whole:
        return "100 %" if whole else "0 %"
    return f"{min(99.999, 100 * part / whole):.3f} %"


def _value(value: Any) -> str:
    text = msgspec.json.encode(value).decode()
    return text if len(text) <= MAX_VALUE_LENGTH else f"{text[: MAX_VALUE_LENGTH - 3]}..."
