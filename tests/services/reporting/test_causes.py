"""Runs with one known cause each: the sentences name it before any other advice, and the option proposed is for it."""

from __future__ import annotations

from typing import Any

import pytest

from ltv_mpc import simulate
from services.reporting.assessment import assessment, next_option

KNOWN: dict[str, Any] = {"seed": 3, "perfect_state": True}
BROKEN = {"plant": {"mismatch": {"thrust": 0.1}}, "water": {"sd_mps": 0.1}}


@pytest.mark.parametrize(
    ("scenario", "changes", "words", "option"),
    [
        (
            "paper-2.5s",
            {**KNOWN, "duration_s": 60.0},
            ["The horizon of 2.4 s is shorter than a turn and a stop: 13.8 s is proposed.", "A plan that ends before"],
            "--horizon-s 13.8",
        ),
        ("paper-no-control", {**KNOWN, "duration_s": 30.0}, ["The lateral thrusts were zero"], None),
        ("descent", {"seed": 3, "duration_s": 20.0}, ["Drift of the estimate", "Better sensors"], "--perfect-state"),
        ("hover", {**KNOWN, "duration_s": 12.0, "water": {"sd_mps": 1.0}}, ["The thrust limits bound it"], None),
        ("hover", {**KNOWN, **BROKEN, "duration_s": 25.0}, ["differs from the vehicle file's", "What degrades"], None),
    ],
    ids=["short horizon", "no thrust", "drift", "current above the top speed", "wrong file"],
)
def test_the_cause_of_the_error_is_named(
    scenario: str, changes: dict[str, Any], words: list[str], option: str | None
) -> None:
    summary = simulate(scenario, **changes).summary
    found = assessment(summary)
    places = [next(i for i, sentence in enumerate(found) if text in sentence) for text in words]
    assert places == sorted(places)
    assert next_option(summary) == option
    if "horizon" in words[0]:
        assert places[0] == 0
