"""Assessment of a run: the larger part of the error is named, and a loss is never left out."""

from __future__ import annotations

from typing import Any

from services.reporting.assessment import assessment, next_option


def summary(tracking: float | None, true: float | None, localisation: float | None, **other: Any) -> dict[str, Any]:
    means = {"tracking_error_m": tracking, "true_error_m": true, "localisation_error_m": localisation}
    usual: dict[str, Any] = {
        **{name: {"mean": mean} for name, mean in means.items()},
        "mode": "services",
        "thrust": {"saturated_fraction": 0.0, "mean_abs_N": 8.0, "max_abs_N": 40.0},
        "end_to_end_delay_s": {"median": 0.21},
        "cycles": 667,
        "deadline_misses": 0,
        "messages": {"published": 9, "dropped": 0, "rejected": 0},
        "restarts": 0,
    }
    return usual | other


SATURATED = {"saturated_fraction": 0.4, "mean_abs_N": 60.0, "max_abs_N": 100.0}


def test_an_error_of_centimetres_is_good_and_gets_no_advice() -> None:
    """A millimetre more than the floor gets advice again."""
    for figures in (summary(0.004, 0.006, 0.002), summary(0.002, 0.006, 0.004), summary(0.049, 0.049, 0.0)):
        found = assessment(figures)
        assert found[0].endswith("on average, which is good: less than 0.05 m.")
        assert found[1] == "No lateral thruster reached its limit."
        assert next_option(figures) is None
    assert next_option(summary(0.051, 0.051, 0.0)) is not None


def test_a_distance_that_became_smaller_again_was_held() -> None:
    """``test_causes.py`` has one that was not."""
    held = {"mean": 0.51, "max": 2.0, "final": 0.3}
    assert "ended at" not in " ".join(assessment(summary(0.50, 0.51, 0.02, thrust=SATURATED, true_error_m=held)))


def test_late_plans_and_losses_are_counted() -> None:
    messages = {"published": 9, "dropped": 3, "rejected": 0, "denied": 0}
    text = " ".join(assessment(summary(0.02, 0.3, 0.3, deadline_misses=4, messages=messages, restarts=1)))
    assert "4 of 667 plans came too late: a lower `--speed` gives them more time." in text
    assert "dropped messages: 3, restarts of processes: 1. The report" in text
    usual = " ".join(assessment(summary(0.02, 0.3, 0.3)))
    assert "No plan came too late. No message was lost." in usual


def test_cycles_with_less_than_nominal_health_are_counted_with_their_reason() -> None:
    health = {"nominal": 600, "degraded: no estimate": 7, "degraded: estimate too uncertain": 60}
    text = " ".join(assessment(summary(0.02, 0.3, 0.3, health=health)))
    assert "not nominal in 67 of 667 cycles, most often degraded: estimate too uncertain." in text
    assert "health" not in " ".join(assessment(summary(0.02, 0.3, 0.3, health={"nominal": 667})))


def test_a_summary_without_figures_gives_no_sentence_about_them() -> None:
    nothing = {"saturated_fraction": None, "mean_abs_N": None, "max_abs_N": None}
    assert assessment(summary(None, None, None, mode="lockstep", thrust=nothing)) == []


def test_late_plans_and_a_health_that_is_not_nominal_come_before_the_thrust() -> None:
    late = assessment(summary(0.50, 0.51, 0.02, thrust=SATURATED, deadline_misses=100))
    assert late[2].startswith("Plans that come too late")
    lost = {"nominal": 400, "degraded: no new estimates": 267}
    sick = assessment(summary(0.50, 0.51, 0.02, thrust=SATURATED, health=lost))
    assert "267 of 667 cycles, most often degraded: no new estimates" in sick[2]
    assert len(sick) == len(set(sick))
