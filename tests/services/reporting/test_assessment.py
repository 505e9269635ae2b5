"""Assessment of a run: the larger part of the error is named, and a loss is never left out."""

from __future__ import annotations

from typing import Any

import pytest

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


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        (summary(0.02, 0.31, 0.30), "0.310 m from the reference on average. Most of this is drift of the estimate"),
        (
            summary(0.50, 0.51, 0.02),
            "0.510 m from the reference on average. Most of this is tracking: a longer horizon",
        ),
        (summary(0.50, 0.51, 0.02, thrust=SATURATED), "Most of this is tracking, which the thrust limits bound."),
        (
            summary(0.50, 0.51, 0.02, thrust={**SATURATED, "saturated_fraction": 0.0, "mean_abs_N": 0.0}),
            "Most of this is tracking, because the lateral thrusts were zero.",
        ),
        (summary(0.50, None, None), "The estimate stayed 0.500 m from the reference on average."),
    ],
)
def test_the_larger_part_of_the_error_is_named(figures: dict[str, Any], words: str) -> None:
    assert words in assessment(figures)[0]


def test_the_next_command_follows_the_sentence_about_the_error() -> None:
    option = next_option(summary(0.50, 0.51, 0.02))
    assert option is not None
    assert option in assessment(summary(0.50, 0.51, 0.02))[0]
    assert next_option(summary(0.02, 0.31, 0.30)) == "--perfect-state"
    assert next_option(summary(0.50, 0.51, 0.02, thrust=SATURATED)) is None
    assert next_option(summary(0.50, None, None)) is None


def test_a_run_with_high_effort_is_not_proposed_again() -> None:
    figures = summary(0.50, 0.51, 0.02, effort="high", horizon_s=13.8)
    assert next_option(figures) == "--horizon-s 28"
    assert "controller.effort" not in assessment(figures)[0]


def test_late_plans_and_losses_are_counted() -> None:
    messages = {"published": 9, "dropped": 3, "rejected": 0, "denied": 0}
    text = " ".join(assessment(summary(0.02, 0.3, 0.3, deadline_misses=4, messages=messages, restarts=1)))
    assert "4 of 667 plans came too late" in text
    assert "dropped messages: 3, restarts of processes: 1. The report" in text
    usual = " ".join(assessment(summary(0.02, 0.3, 0.3)))
    assert "No plan came too late. No message was lost." in usual


def test_cycles_with_less_than_nominal_health_are_counted_with_their_reason() -> None:
    health = {"nominal": 600, "degraded: no estimate": 7, "degraded: estimate too uncertain": 60}
    text = " ".join(assessment(summary(0.02, 0.3, 0.3, health=health)))
    assert "not nominal in 67 of 667 cycles, most often degraded: estimate too uncertain." in text
    assert "health" not in " ".join(assessment(summary(0.02, 0.3, 0.3, health={"nominal": 667})))


def test_lock_step_says_nothing_of_delays_and_losses() -> None:
    text = " ".join(assessment(summary(0.02, 0.3, 0.3, mode="lockstep")))
    assert "too late" not in text
    assert "lost" not in text


def test_a_summary_without_figures_gives_no_sentence_about_them() -> None:
    nothing = {"saturated_fraction": None, "mean_abs_N": None, "max_abs_N": None}
    assert assessment(summary(None, None, None, mode="lockstep", thrust=nothing)) == []
