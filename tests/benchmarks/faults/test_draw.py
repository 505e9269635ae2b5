"""Faults of a campaign: a function of its seed, spread over classes and targets, in sequence."""

from __future__ import annotations

from collections import Counter

from benchmarks.faults import campaign, draw, kinds
from benchmarks.faults.kinds import Place

INSIDE = [kind for kind in kinds.KINDS if kind.place is Place.LOCKSTEP]


def drawn(n: int = 200, *, seed: int = 3, pace: draw.Pace = campaign.PACE) -> list[draw.Run]:
    return draw.runs(INSIDE, n, seed=seed, several=8, seeds=4, pace=pace)


def test_faults_are_a_function_of_the_seed_and_spread_evenly_over_classes_and_targets():
    assert drawn() == drawn() != drawn(seed=4)
    faults = [fault for run in drawn(400) for fault in run.faults]
    assert len(faults) == 400
    assert set(Counter(fault.kind for fault in faults).values()) == {16}
    off = Counter(fault.target for fault in faults if fault.kind == "sensor_off")
    assert set(off) == set(kinds.INSTRUMENTS)
    assert max(off.values()) - min(off.values()) <= 1
