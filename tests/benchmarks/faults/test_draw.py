"""Faults of a campaign: a function of its seed, spread over classes and targets, in sequence."""

from __future__ import annotations

import itertools
from collections import Counter

import pytest

from benchmarks.faults import campaign, draw, kinds
from benchmarks.faults.kinds import Place
from ltv_mpc.errors import ConfigError

INSIDE = [kind for kind in kinds.KINDS if kind.place is Place.LOCKSTEP]


def drawn(n: int = 200, *, seed: int = 3, pace: draw.Pace = campaign.PACE) -> list[draw.Run]:
    return draw.runs(INSIDE, n, seed=seed, several=8, seeds=4, pace=pace)


def test_a_seed_gives_the_same_faults_and_another_gives_others():
    assert drawn() == drawn()
    assert drawn() != drawn(seed=4)


def test_faults_are_spread_evenly_over_classes_and_targets():
    faults = [fault for run in drawn(400) for fault in run.faults]
    assert len(faults) == 400
    assert set(Counter(fault.kind for fault in faults).values()) == {16}
    off = Counter(fault.target for fault in faults if fault.kind == "sensor_off")
    assert set(off) == set(kinds.INSTRUMENTS)
    assert max(off.values()) - min(off.values()) <= 1


def test_in_a_run_a_minute_passes_between_two_faults_and_after_the_last():
    for run in drawn():
        under = [fault for fault in run.faults if fault.target not in kinds.AFLOAT]
        for before, after in itertools.pairwise(under):
            assert after.start_s - before.end_s >= 60.0
        assert all(fault.end_s < 0.0 for fault in run.faults if fault.target in kinds.AFLOAT)
        for fault in under:
            assert fault.end_s == run.duration_s if fault.permanent else fault.end_s + 60.0 <= run.duration_s


@pytest.mark.parametrize("seed", range(5))
def test_a_run_has_at_most_one_undeclared_antenna_because_its_alarm_outlasts_it(seed):
    found = [sum(fault.kind == "reference_point" for fault in run.faults) for run in drawn(400, seed=seed)]
    assert sum(found) == 16
    assert max(found) == 1


@pytest.mark.parametrize(
    ("classes", "where", "said"),
    [
        ("sensor_of", "both", "must be one of sensor_off, sensor_stuck"),
        ("thruster_loss", "processes", "no fault class of thruster_loss exists there"),
    ],
)
def test_what_is_not_there_is_refused_by_name(classes, where, said):
    with pytest.raises(ConfigError) as refused:
        campaign.plan(classes, where, 10)
    assert said in str(refused.value)
