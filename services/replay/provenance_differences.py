"""Differences between a run's provenance and this machine: versions, commit, processor, vector instructions.

On another processor the last bits of a product or a sine may differ, and so may every later output.
"""

from __future__ import annotations

from collections.abc import Mapping

from services.replay.verdict import ProvenanceDifference
from services.run.provenance import provenance_table
from services.run.run_config import ORIGIN

ABSENT = "not recorded"


def provenance_differences(made: Mapping[str, str] | None) -> tuple[ProvenanceDifference, ...]:
    """Return each entry of a run's [made_by] that differs on this machine."""
    run, here = dict(made or {}), provenance_table()
    run.pop(ORIGIN, None)
    return tuple(
        ProvenanceDifference(what=name, run=run.get(name, ABSENT), here=here.get(name, ABSENT))
        for name in {**here, **run}
        if run.get(name, ABSENT) != here.get(name, ABSENT)
    )
