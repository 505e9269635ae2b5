"""Verdict of a replay: how many steps were compared and identical, and the first difference."""

from __future__ import annotations

from typing import Any

import msgspec

MAX_FIELDS = 20
"""Fields of a difference that are listed; all are counted."""

MAX_GAPS = 20
"""Gaps of a node that are listed; all are counted."""


class FieldDifference(msgspec.Struct, frozen=True, kw_only=True):
    """Value that differs: ``path`` as in ``thrust_N[3][0]``, the values as JSON; None: missing, or null."""

    path: str
    recorded: Any
    replayed: Any


class Difference(msgspec.Struct, frozen=True, kw_only=True):
    """Step whose output is not the recorded one. ``what`` describes differences that are not in the fields."""

    node: str
    epoch: int
    step: int
    t_ns: int
    key: str
    sequence: int
    what: str
    fields: tuple[FieldDifference, ...] = ()
    more_fields: int = 0


class Gap(msgspec.Struct, frozen=True, kw_only=True):
    """Steps of one epoch that cannot be replayed, from ``first_step`` to its end, because something is missing."""

    epoch: int
    first_step: int
    steps: int
    t_ns: int | None  # of the first step whose record exists
    why: str


class NodeVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """Verdict on one node, over all its epochs.

    A step is compared if its record, its inbox and its outputs are in the file, and all earlier steps of its epoch
    could be replayed. ``outputs_lost`` were published and are not in the file; ``outputs_unpublished`` were not
    published yet when the node or the run ended.
    """

    node: str
    starts: int
    steps_run: int
    steps_compared: int
    steps_identical: int
    outputs_compared: int
    outputs_lost: int
    outputs_unpublished: int
    gaps: tuple[Gap, ...]
    more_gaps: int
    first_difference: Difference | None


class ProvenanceDifference(msgspec.Struct, frozen=True, kw_only=True):
    """Entry of the run's provenance that differs on this machine."""

    what: str
    run: str
    here: str


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """Verdict on all nodes of a run."""

    recording: str
    scenario: str
    mode: str
    cut: bool  # the file is truncated
    vehicle_s: float
    wall_s: float
    times_real_time: float
    identical: bool  # every compared step, and there is at least one
    steps_run: int
    steps_compared: int
    steps_identical: int
    nodes: tuple[NodeVerdict, ...]
    first_difference: Difference | None
    provenance_differences: tuple[ProvenanceDifference, ...]


class Change(msgspec.Struct, frozen=True, kw_only=True):
    """Setting that differs from the run's; None: it is not set."""

    key: str
    run: Any
    here: Any


class Deviation(msgspec.Struct, frozen=True, kw_only=True):
    """Replayed minus recorded value: root mean square, largest magnitude, and the last one."""

    of: str
    unit: str
    rms: float
    max_abs: float
    final: float


class Shares(msgspec.Struct, frozen=True, kw_only=True):
    """Shares of one origin among the recorded and replayed plans."""

    origin: str
    recorded: float
    replayed: float


class WhatIfVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """Comparison of one node with other settings. ``pairs``: outputs of the same epoch and time on both sides."""

    recording: str
    scenario: str
    settings: str
    node: str
    changes: tuple[Change, ...]
    steps_run: int
    steps_replayed: int
    recorded: int
    replayed: int
    pairs: int
    deviations: tuple[Deviation, ...]
    shares: tuple[Shares, ...]
    wall_s: float
    provenance_differences: tuple[ProvenanceDifference, ...]
