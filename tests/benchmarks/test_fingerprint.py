"""Fingerprint of a run's numbers: equal for equal runs, different if one number differs."""

from benchmarks import fingerprint
from services.run.nodes import make_nodes


def hashes(*settings):
    of = fingerprint.run_config("hover", "run.duration_s=2.0", *settings)
    return {role: fingerprint.digest(rows) for role, rows in fingerprint.lockstep(of, make_nodes(of)).items()}


def test_another_weight_changes_plans_and_a_known_state_changes_estimates():
    plain, other, known = hashes(), hashes("controller.weights.thrust=0.0031"), hashes("run.perfect_state=true")
    assert plain["plan"] != other["plan"]
    assert plain["applied"] != other["applied"]
    assert plain["estimate"] != known["estimate"]
