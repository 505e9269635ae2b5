"""What a replay came to: how many steps could be compared, how many were identical, and the first that was not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec

MAX_FIELDS = 20
"""Of a difference; what is beyond is counted."""

MAX_GAPS = 20
"""Of a node; what is beyond is counted."""


class FieldDifference(msgspec.Struct, frozen=True, kw_only=True):
    """One value: ``path`` as in ``thrust_N[3][0]``, the values as JSON; None: not there, or null."""

    path: str
    recorded: Any
    replayed: Any


class Difference(msgspec.Struct, frozen=True, kw_only=True):
    """A step whose output is not the recorded one. ``what`` says how, where it is not in the fields."""

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
    """Steps of one epoch that cannot be replayed, from ``first_step`` to its end, because something is not there."""

    epoch: int
    first_step: int
    steps: int
    t_ns: int | None  # of the first one whose record is there
    why: str


class NodeVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """One node, over all its epochs.

    A step is compared where its record, its inbox and its outputs are in the file and the steps of its epoch before it
    could be replayed. ``outputs_lost`` were published and are not in the file; ``outputs_unpublished`` were still to be
    published when the node or the run ended.
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


class Elsewhere(msgspec.Struct, frozen=True, kw_only=True):
    """Something that made the run and is otherwise here."""

    what: str
    run: str
    here: str


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """All nodes."""

    recording: str
    scenario: str
    mode: str
    cut: bool  # the file ends in its middle
    vehicle_s: float
    wall_s: float
    times_real_time: float
    identical: bool  # every step that can be compared, and there is one
    steps_run: int
    steps_compared: int
    steps_identical: int
    nodes: tuple[NodeVerdict, ...]
    first_difference: Difference | None
    elsewhere: tuple[Elsewhere, ...]


class Change(msgspec.Struct, frozen=True, kw_only=True):
    """A setting that is another than in the run; None: it is not set."""

    key: str
    run: Any
    here: Any


class Deviation(msgspec.Struct, frozen=True, kw_only=True):
    """Replayed minus recorded: root mean square, largest size, and the last one."""

    of: str
    unit: str
    rms: float
    max_abs: float
    final: float


class Shares(msgspec.Struct, frozen=True, kw_only=True):
    """Shares of the plans of one origin."""

    origin: str
    recorded: float
    replayed: float


class WhatIfVerdict(msgspec.Struct, frozen=True, kw_only=True):
    """One node with the settings of a file. ``pairs``: outputs of one epoch and time that both have."""

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
    elsewhere: tuple[Elsewhere, ...]


def first(differences: Sequence[Difference | None]) -> Difference | None:
    """The earliest in vehicle time."""
    there = [difference for difference in differences if difference is not None]
    return min(there, key=lambda difference: difference.t_ns, default=None)
