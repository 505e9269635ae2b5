"""Fingerprint of a run's numbers: equal for equal runs, different if one number differs."""

import numpy as np

from benchmarks import fingerprint
from services.run.nodes import make_nodes


def hashes(*settings):
    of = fingerprint.run_config("hover", "run.duration_s=2.0", *settings)
    return {role: fingerprint.digest(rows) for role, rows in fingerprint.lockstep(of, make_nodes(of)).items()}


def test_the_same_run_has_the_same_fingerprint_in_every_role():
    first, again = hashes(), hashes()
    assert first == again
    assert set(first) == {"estimate", "plan", "applied"}
    assert len(set(first.values())) == 3


def test_another_weight_changes_plans_and_a_known_state_changes_estimates():
    plain, other, known = hashes(), hashes("controller.weights.thrust=0.0031"), hashes("run.perfect_state=true")
    assert plain["plan"] != other["plan"]
    assert plain["applied"] != other["applied"]
    assert plain["estimate"] != known["estimate"]


def test_a_difference_is_said_by_its_size_and_none_where_every_bit_is_the_same():
    old = np.array([1.0, np.nan, 3.0])
    assert fingerprint.difference(old, old.copy()) == ""
    assert "2" in fingerprint.difference(np.array([1.0, np.nan, 5.0]), old)
    assert "3 -> 2" in fingerprint.difference(old[:2], old)
    assert fingerprint.difference(old, None) == "not in the other"


def test_every_family_of_faults_of_lock_step_has_a_run():
    families = {row.name for row in fingerprint.kinds.KINDS if row.place is fingerprint.Place.LOCKSTEP}
    assert families == {name.removeprefix("fault: ") for name in fingerprint.runs() if name.startswith("fault: ")}
