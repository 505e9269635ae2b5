"""A small campaign, really made: a fault of every class in lock step, and messages harmed between real processes.

Left out for its length: what is done to processes themselves (tests/services/supervisor kills and stops them), and what
the error is a minute after a fault, which a full campaign judges.
"""

from __future__ import annotations

import json

import pytest

from benchmarks.faults import campaign, inject, kinds, lockstep, recorded
from benchmarks.faults.__main__ import main
from benchmarks.faults.draw import Run
from benchmarks.faults.kinds import Fault, Place
from ltv_mpc.vehicle.parameters import Vehicle
from services.replay import replay
from services.tools.batch.results_store import NAME, read


@pytest.mark.timeout(400)
def test_a_quick_campaign_has_no_bad_thrust_or_uncounted_loss(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(campaign, "remove", lambda _: None)  # keeps runs in which all was well
    monkeypatch.setattr(campaign, "SHARE_IN_PROCESSES", 0.0)  # one fault of each class, in one run
    code = main(["--quick", "--n", "32", "--seed", "3", "--json", "--out", str(tmp_path)])
    of = json.loads(capsys.readouterr().out)
    assert {name: of[name] for name in ("injected", "in_processes")} == {"injected": 32, "in_processes": 5}
    assert of["classes"] == len([kind for kind in kinds.KINDS if kind.place is Place.LOCKSTEP])
    broken = {name: of[name] for name in ("uncontrolled", "bad_thrusts", "uncounted", "false_figures")}
    assert broken == dict.fromkeys(broken, 0), of["violations"]
    assert code == bool(of["violations"])
    seen = [one for _, result in read(tmp_path / NAME)[1] for one in result]
    late = [one for one in seen if one.get("late") and one["place"] == "lockstep"]  # processes wait for the machine
    assert late == []
    harmed = {one["fault"]["kind"]: one["harmed"] for one in seen if one["place"] == "processes"}
    assert len(harmed) == 5  # classes
    assert all(harmed.values())  # else this shows nothing
    named = {one["fault"]["kind"] for one in seen if one["harmed"]}
    assert {"not_a_number", "estimate_dropout", "second_source", *kinds.NAMES[7:12], *kinds.NAMES[25:27]} <= named
    assert json.loads((tmp_path / "faults.json").read_text()) == of
    # The recorder heard one router alone: what was said at the other and lost on its way is in the file nonetheless.
    assert {one["fault"]["target"] for one in seen if one["place"] == "processes"} == {"estimate", "plan", "applied"}
    (recording,) = tmp_path.glob("bus-*/run.mcap")
    log = recorded.Recorded(recording, Vehicle.load("paper")).log
    assert min(len(log.cycles), len(log.received_estimates), len(log.gate)) > 60  # else no requirement on them binds
    recorded.with_link(recording, recording.with_name(inject.LINK), tmp_path / "both.mcap")
    verdict = replay.replay(replay.Run(tmp_path / "both.mcap"), only="controller")
    assert verdict.identical, verdict.first_difference
    assert verdict.steps_compared == verdict.steps_run > 60


def test_faults_move_nothing_before_they_begin():
    """What is injected comes from outside: until then the run is that of its seed, bit for bit."""
    fault = Fault(kind="not_a_number", target="estimate", start_s=6.0, end_s=9.0, size=0.5, seed=1)
    runs = [
        lockstep.observe(Run(seed=4, faults=faults, duration_s=8.0, afloat_s=3.0))[0].log for faults in ((), (fault,))
    ]
    without, with_it = ([row for row in log.truth if row[0] < 6 * 10**9] for log in runs)
    assert without == with_it
    assert runs[0].estimate[:80] == runs[1].estimate[:80]
    assert runs[1].rejected
    assert not runs[0].rejected
