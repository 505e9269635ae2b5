"""A small campaign, really made: ten classes in lock step, and messages harmed between real processes.

Left out for its length: what is done to processes themselves (killed, stopped, slowed, disk full), which
``ltv-mpc faults --quick`` does, and what the error is a minute after a fault, which takes a full campaign.
"""

from __future__ import annotations

import json

import pytest

from services.cli.app import run as command
from services.faults import attacks, bench, campaign, inside, kinds
from services.faults.draw import Run
from services.faults.fault import Fault, Place
from services.faults.judge_outside import judge

CLASSES = (
    "sensor_off,sensor_stuck,sensor_garbage,message_loss,message_delay,message_reorder,message_duplicate,"
    "message_corruption,not_a_number,solver_failure"
)


def test_ten_classes_of_faults_in_lock_step_end_in_no_bad_thrust_and_no_late_reaction(capsys):
    code = command(
        ["faults", "--quick", "--n", "10", "--where", "lockstep", "--seed", "3", "--json", "--classes", CLASSES]
    )
    of = json.loads(capsys.readouterr().out)
    counts = {name: of[name] for name in ("classes", "injected", "in_processes")}
    assert counts == {"classes": 10, "injected": 10, "in_processes": 0}
    broken = {name: of[name] for name in ("uncontrolled_exits", "bad_thrusts", "uncounted_losses", "late_reactions")}
    assert broken == dict.fromkeys(broken, 0), of["not_kept"]
    assert code == 0


def test_faults_move_nothing_before_they_begin():
    """What is injected comes from outside: until then the run is that of its seed, bit for bit."""
    fault = Fault(kind="not_a_number", target="estimate", start_s=6.0, end_s=9.0, size=0.5, seed=1)
    runs = [inside.observe(Run(seed=4, faults=faults, duration_s=8.0, afloat_s=3.0)).log for faults in ((), (fault,))]
    without, with_it = ([row for row in log.truth if row[0] < 6 * 10**9] for log in runs)
    assert without == with_it
    assert runs[0].estimate[:80] == runs[1].estimate[:80]
    assert runs[1].rejected
    assert not runs[0].rejected


@pytest.mark.timeout(400)
def test_messages_harmed_between_processes_are_refused_and_counted(tmp_path):
    harms = (("message_loss", "estimate", 0.6), ("message_duplicate", "applied", 1.0), ("message_reorder", "plan", 0.5))
    faults = tuple(
        Fault(kind=kind, target=target, start_s=4.0 + 5.0 * i, end_s=6.0 + 5.0 * i, size=size, seed=1)
        for i, (kind, target, size) in enumerate(harms)
    )
    run = Run(seed=3, faults=faults, duration_s=20.0, afloat_s=4.0)
    of = campaign.behind_injector(run, tmp_path / "run")
    assert of.uncontrolled == ""
    assert all(harmed > 0 for harmed in of.harmed)
    for seen in judge(of, inside.situation(run).vehicle, None):
        assert seen.place is Place.PROCESSES
        assert (seen.uncounted, seen.bad_thrusts) == (0, 0)


def test_the_injector_is_told_what_the_campaign_has_drawn():
    fault = Fault(kind="message_delay", target="plan", start_s=3.25, end_s=4.5, size=0.125, seed=77)
    assert bench.words(bench.injection(fault)) == "delay,plan,3.25,4.5,0.125,77"


def test_every_class_of_processes_is_one_that_can_be_done_to_them():
    for kind in (kind for kind in kinds.KINDS if kind.place is Place.PROCESSES):
        assert kind.name.startswith("message_") or kind.name in attacks.ATTACKS
