"""Facts about the safety of a run: what was not nominal is counted over the run, with its most frequent reason."""

from __future__ import annotations

import msgspec
import pytest

from ltv_mpc.messages import FenceReport, FilterStatus, Health, Message
from services.reporting.safety import Fact, Mood, RunSafety
from tests.services.reporting import synthetic_run
from tests.services.reporting.synthetic_run import EPOCH, WRECK
from tests.services.words import status


def facts(*messages: Message) -> dict[str, Fact]:
    safety = RunSafety()
    for message in messages:
        safety.add(message, EPOCH)
    return {fact.name: fact for fact in safety.facts()}


def test_a_nominal_run_is_good() -> None:
    found = facts(*(message for _, message, _ in synthetic_run.dive()))
    assert (found["health"].text, found["health"].mood) == ("nominal in all 70 cycles", Mood.GOOD)
    assert found["command authority"].text == "controller in all cycles"
    assert found["plan"].text == "solved in all cycles"
    assert (found["filter"].text, found["filter"].mood) == ("nominal in all 22 reports", Mood.GOOD)
    assert (found["fence"].text, found["fence"].mood) == (f"plans keep 3.00 m or more from {WRECK}", Mood.GOOD)


def test_what_was_not_nominal_is_counted_with_its_most_frequent_reason() -> None:
    late, unsure = (
        msgspec.structs.replace(synthetic_run.plan(0), health=Health.DEGRADED, health_why=why)
        for why in ("no new estimates", "estimate too uncertain")
    )
    report = msgspec.structs.replace(synthetic_run.report(0), status=FilterStatus.INCONSISTENT, why="adcp")
    found = facts(synthetic_run.plan(0), late, unsure, unsure, synthetic_run.report(0), report)
    assert found["health"].mood is found["filter"].mood is Mood.BAD
    assert found["health"].text == "nominal in 1 of 4 cycles, otherwise most often degraded: estimate too uncertain"
    assert found["filter"].text == "nominal in 1 of 2 reports, otherwise most often inconsistent: adcp"


@pytest.mark.parametrize(
    ("before", "wrong", "after", "mood"),
    [(0, 1, 99, Mood.NEUTRAL), (50, 1, 49, Mood.NEUTRAL), (0, 2, 98, Mood.BAD), (99, 1, 0, Mood.BAD)],
)
def test_it_is_bad_only_at_the_end_or_in_more_than_one_in_a_hundred(before, wrong, after, mood) -> None:
    nominal, report = synthetic_run.plan(0), synthetic_run.report(0)
    late = msgspec.structs.replace(nominal, health=Health.HOLD, health_why="no new estimates")
    unsure = msgspec.structs.replace(report, status=FilterStatus.INCONSISTENT, why="adcp")
    found = facts(*[nominal] * before, *[late] * wrong, *[nominal] * after)
    assert found["health"].mood is mood
    assert facts(*[report] * before, *[unsure] * wrong, *[report] * after)["filter"].mood is mood


def test_the_nearest_zone_and_a_hull_in_a_margin_are_named() -> None:
    def plan(clearance_m: float, in_margin: tuple[str, ...] = ()) -> Message:
        fence = FenceReport(clearance_m=clearance_m, nearest=f"zone at {clearance_m:g}", in_margin=in_margin)
        return msgspec.structs.replace(synthetic_run.plan(0), fence=fence)

    found = facts(plan(5.0), plan(0.5, ("reef",)), plan(7.0))["fence"]
    text = "plans keep 0.50 m or more from zone at 0.5; the hull was in a zone or its margin in 1 cycles"
    assert (found.text, found.mood) == (text, Mood.BAD)
    lacking = FenceReport(clearance_m=9.0, nearest="buoy", exceeded=4)
    found = facts(plan(5.0), msgspec.structs.replace(synthetic_run.plan(0), fence=lacking))["fence"]
    text = "plans keep 5.00 m or more from zone at 5; 1 plans lack more than 1 cm of a required clearance"
    assert (found.text, found.mood) == (text, Mood.BAD)
    assert "fence" not in facts(msgspec.structs.replace(synthetic_run.plan(0), fence=None))


def test_a_process_is_counted_over_all_of_its_starts() -> None:
    """Each report counts by its steps: 10 of 100 us, 30 of 20 us and, after a restart, 40 of 60 us."""
    safety = RunSafety()
    safety.add(status("recorder"), 1)
    for epoch, steps, step_us, lost in ((1, 10, 100.0, 2), (1, 40, 20.0, 3), (2, 40, 60.0, 4)):
        safety.add(status("estimator", steps=steps, step_us=step_us, dropped=lost, rejected=1), epoch)
    safety.add(status("estimator", steps=40, step_us=0.0, dropped=4, rejected=1, finished=True), 2)
    estimator, recorder = safety.processes()
    assert (estimator.name, estimator.state, estimator.starts) == ("estimator", "finished", 2)
    assert estimator.lost == 3 + 1 + 4 + 1
    assert estimator.step_us == (10 * 100 + 30 * 20 + 40 * 60) / 80
    assert (recorder.state, recorder.step_us, recorder.lost) == ("running", None, 0)
