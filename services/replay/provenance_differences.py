"""What made a run and is otherwise on this machine: versions, commit, processor, and what its vector instructions do.

On another processor the last bits of a product or a sine may be others, and so may every output from there on.
"""

from __future__ import annotations

from collections.abc import Mapping

from services.replay.verdict import Elsewhere
from services.run.provenance import provenance_table
from services.run.run_config import ORIGIN

ABSENT = "not recorded"


def elsewhere(made: Mapping[str, str] | None) -> tuple[Elsewhere, ...]:
    """Each entry of a run's [made_by] that differs here."""
    run, here = dict(made or {}), provenance_table()
    run.pop(ORIGIN, None)
    return tuple(
        Elsewhere(what=name, run=run.get(name, ABSENT), here=here.get(name, ABSENT))
        for name in {**here, **run}
        if run.get(name, ABSENT) != here.get(name, ABSENT)
    )
