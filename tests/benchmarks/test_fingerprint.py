"""Fingerprint of a run's numbers: equal for equal runs, different if one number differs."""

from benchmarks import fingerprint


def hashes(*settings):
    made = fingerprint.plain("hover", "run.duration_s=2.0", *settings)
    return {role: fingerprint.digest(rows) for role, rows in made.items()}


def test_another_weight_changes_plans_and_a_known_state_changes_estimates():
    plain, other, known = hashes(), hashes("controller.weights.thrust=0.0031"), hashes("run.perfect_state=true")
    assert plain == hashes()
    assert plain["plan"] != other["plan"]
    assert plain["applied"] != other["applied"]
    assert plain["estimate"] != known["estimate"]
