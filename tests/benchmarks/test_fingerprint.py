"""Fingerprint of a run's numbers: equal for equal runs, different if one number differs."""

from benchmarks import fingerprint


def hashes(*settings):
    made = fingerprint.plain("hover", "run.surface_time_s=1.0", "run.duration_s=1.0", *settings)
    return {role: fingerprint.digest(rows) for role, rows in made.items()}


def test_another_weight_changes_plans_and_the_same_run_changes_nothing():
    plain = hashes()
    assert plain == hashes()
    assert plain["plan"] != hashes("controller.weights.thrust=0.0031")["plan"]
