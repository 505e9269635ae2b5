"""The loop in the README moves the vehicle to its point."""

from __future__ import annotations

import math

from tests.docs.pages import blocks


def loop() -> str:
    (code,) = (block.text for block in blocks("README.md") if block.language == "python")
    return code


def test_the_loop_works_as_printed_and_brings_the_vehicle_to_its_point():
    names: dict[str, object] = {}
    exec(loop(), names)
    estimate = names["estimate"]
    assert math.hypot(estimate.north_m, estimate.east_m) < 0.1  # type: ignore[attr-defined]
    assert names["plan"].origin == "solved"  # type: ignore[attr-defined]
