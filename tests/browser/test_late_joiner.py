"""A browser that opens the page of a run at t = 60 s shows the distances of the verdict, from t = 0 on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ltv_mpc.vehicle.parameters import Vehicle
from services.dashboard.bus_feed import BusFeed
from services.supervisor import loopback
from tests.browser.conftest import SCREEN, looks, tab
from tests.services.dashboard.synthetic_vehicle import serving
from tests.services.dashboard.test_late_joining import END_S, JOIN_S, recorded_dive, verdict
from tests.services.reporting.synthetic_run import CYCLE_NS, SPEED_NORTH_MPS, S
from tests.services.words import status
from tests.waiting import until

FIGURE = """name => {
  const row = [...document.querySelectorAll("#facts div")].find(row => row.firstChild.textContent === name);
  return row ? row.lastChild.textContent : "";
}"""

MAX_DIFFERENCE_M = SPEED_NORTH_MPS * CYCLE_NS / S
"""Distance that the vehicle moves while a figure waits for the next plan."""

BEGINS_S = """(document.querySelector('#plot-tracking').data ?? [])
  .find(one => one.series.table === 'true_distance')?.x[0] ?? Infinity"""


def test_a_late_page_in_a_browser_shows_the_figures_of_the_verdict(browser: Any, tmp_path: Path) -> None:
    with (
        recorded_dive(tmp_path, loopback.free_port()) as (publisher, ashore, bus),
        serving(BusFeed(ashore, Vehicle.load("paper")), bus) as shown,
        tab(browser, SCREEN, own=shown.url) as page,
    ):
        page.goto(shown.url)
        until(lambda: publisher.outs["plant"].publish(status("plant")) or page.inner_text("#link") == "live")
        for tenth in range(JOIN_S * 10 + 1, END_S * 10 + 1):
            publisher.publish(tenth / 10)
        tracking, true, *_ = verdict().track.errors()
        assert true.final is not None
        assert tracking.final is not None
        assert abs(true.final - tracking.final) > 0.1  # one cannot pass for the other
        for name, figure in (("estimate from the reference", tracking), ("vehicle from the reference", true)):
            expected = pytest.approx(figure.final, abs=MAX_DIFFERENCE_M)
            until(lambda name=name, at=expected: is_shown(page, name, at) or publisher.repeat())  # type: ignore[misc]
        until(lambda: page.evaluate(BEGINS_S) < 1.0)
        for _ in looks(page):
            assert is_shown(page, "estimate from the reference", pytest.approx(tracking.final, abs=MAX_DIFFERENCE_M))
            assert is_shown(page, "vehicle from the reference", pytest.approx(true.final, abs=MAX_DIFFERENCE_M))


def is_shown(page: Any, name: str, expected_m: object) -> bool:
    """Return True if the page shows this distance, and not since when it counts."""
    number, _, unit = page.evaluate(FIGURE, name).partition(" ")
    return unit == "m" and float(number) == expected_m
