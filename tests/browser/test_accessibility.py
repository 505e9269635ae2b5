"""Live page and report can be used by keyboard, with text of twice the size, and by readers of a screen (axe-core).

axe-core comes from npm, by ``npm ci --prefix tests/browser``. Without it its tests skip; with REQUIRE_AXE=1 they fail.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.browser.conftest import LOOKS, SCHEMES, SCREEN, background, ended, looks, tab
from tests.services.dashboard.synthetic_vehicle import Served
from tests.waiting import until

AXE = Path(__file__).parent / "node_modules" / "axe-core" / "axe.min.js"

VIOLATIONS = """async () => {
  const tags = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"];
  const found = await axe.run(document, { runOnly: { type: "tag", values: tags } });
  return found.violations.filter(one => ["serious", "critical"].includes(one.impact))
    .map(one => `${one.id}: ${one.nodes.map(node => node.html.slice(0, 120)).join(" | ")}`);
}"""

CONTROLS = """() => {
  const all = [...document.querySelectorAll("button, select, input, summary, a[href], [tabindex='0']")];
  const usable = all.filter(one => !one.disabled && one.checkVisibility({ visibilityProperty: true }));
  all.forEach(one => delete one.dataset.reach);
  usable.forEach((one, i) => { one.dataset.reach = i; });
  return usable.length;
}"""
"""Number every control that can be seen and used."""

FOCUSED = """() => {
  const one = document.activeElement, box = one.getBoundingClientRect(), style = getComputedStyle(one);
  const hit = document.elementFromPoint(box.left + box.width / 2, box.top + Math.min(box.height, 20) / 2);
  const shown = one.contains(hit) && style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2;
  return shown && one.dataset.reach !== undefined ? Number(one.dataset.reach) : -1;
}"""
"""Number of the control with the focus, if it is in the window, under nothing else, and has an outline; else -1."""


@pytest.fixture(scope="module")
def axe() -> str:
    if not AXE.is_file():
        missing = "no axe-core: run npm ci --prefix tests/browser"
        if os.environ.get("REQUIRE_AXE") == "1":
            pytest.fail(missing)
        pytest.skip(missing)
    return AXE.read_text(encoding="utf-8")


@contextmanager
def opened(browser: Any, what: str, live: Served, report: Path) -> Iterator[Any]:
    """Open the live page or a report, and wait until all of it is there."""
    url = report.as_uri() if what == "report" else live.url
    with tab(browser, SCREEN, own=url) as page:
        page.goto(url if what == "report" else f"{url}#{live.token}")
        if what == "live page":
            until(lambda: page.inner_text("#link") == "live")
            until(lambda: page.locator("#buttons button:enabled").count() > 5)
            until(lambda: page.locator("#events tr").count() > 0)
        until(lambda: page.locator(".js-plotly-plot .xtitle").count() > 10)
        yield page


@pytest.fixture(scope="module", params=["report", "live page"])
def shown(request: pytest.FixtureRequest, browser: Any, live: Served, report: Path) -> Iterator[Any]:
    """Open a page for all tests that look at it; the last of them ends the run of the live page."""
    with opened(browser, request.param, live, report) as page:
        yield page


def check_with_axe(page: Any, axe: str) -> None:
    page.evaluate(axe)
    for scheme in SCHEMES:
        page.emulate_media(color_scheme=scheme)
        until(lambda scheme=scheme: background(page) == scheme)  # type: ignore[misc]
        assert page.evaluate(VIOLATIONS) == []


def test_axe_finds_no_serious_violation(shown: Any, axe: str) -> None:
    check_with_axe(shown, axe)


def check_keyboard(page: Any, least: int, keys: tuple[str, ...] = ("Tab", "Shift+Tab")) -> None:
    """Check that each of ``keys`` comes to every control, and that the page shows the one that it is at."""
    number = page.evaluate(CONTROLS)
    assert number >= least
    for key in keys:
        left, presses = set(range(number)), 0
        while left and presses < number + 10:
            page.keyboard.press(key)
            left.discard(page.evaluate(FOCUSED))
            presses += 1
        assert [page.locator(f"[data-reach='{i}']").evaluate("one => one.outerHTML") for i in left] == []


def test_the_keyboard_reaches_every_control(shown: Any) -> None:
    """Buttons, speed, the earlier moments, lists that scroll, menus with their files, whole track."""
    if shown.locator("#moment").count() == 0:  # the report
        check_keyboard(shown, 20)
        return
    shown.focus("#moment")
    shown.keyboard.press("Home")
    until(lambda: shown.locator("#now:enabled").count() == 1)
    shown.focus("#panel-depth summary")
    shown.keyboard.press("Enter")
    until(lambda: shown.locator("#panel-depth .menu button:visible").count() == 3)
    check_keyboard(shown, 28)
    shown.focus("#panel-depth summary")
    shown.keyboard.press("Enter")
    shown.click("#now")


@pytest.mark.parametrize("shown", ["live page"], indirect=True)
def test_after_the_end_everyone_can_use_the_page(shown, live, report, axe) -> None:
    with ended(live, report):
        until(lambda: shown.locator("#finished a").count() == 1)
        check_with_axe(shown, axe)
        check_keyboard(shown, 18, ("Tab",))
        assert shown.locator("#finished [data-reach]").count() == 2


@pytest.mark.parametrize("what", ["live page", "report"])
def test_text_of_twice_the_size_loses_nothing(large_letters, live, report, what) -> None:
    with opened(large_letters, what, live, report) as page:
        assert page.evaluate("getComputedStyle(document.querySelector('h1')).fontSize") == "32px"
        assert page.evaluate("getComputedStyle(document.querySelector('#plot-depth .xtitle')).fontSize") == "22px"
        for _ in looks(page, LOOKS[-1:]):  # the narrowest
            assert page.locator(".panel h3").count() > 10
