"""Live page and report can be used by keyboard, with text of twice the size, and by readers of a screen (axe-core).

axe-core comes from npm, by ``npm ci --prefix tests/browser``. Without it its tests skip; with REQUIRE_AXE=1 they fail.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from tests.browser.conftest import SCHEMES, SCREEN, background, ended, looks, tab
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


def shown_live(page: Any, live: Served) -> None:
    page.goto(f"{live.url}#{live.token}")
    until(lambda: page.inner_text("#link") == "live")
    until(lambda: page.locator("#buttons button:enabled").count() > 5)
    until(lambda: page.locator("#events tr").count() > 0)
    until(lambda: page.locator(".js-plotly-plot .xtitle").count() > 10)


def shown_report(page: Any, report: Path) -> None:
    page.goto(report.as_uri())
    until(lambda: page.locator(".js-plotly-plot .xtitle").count() > 10)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_axe_finds_no_serious_violation_on_the_live_page(browser: Any, live: Served, axe: str, scheme: str) -> None:
    with tab(browser, SCREEN, own=live.url, scheme=scheme) as page:
        shown_live(page, live)
        page.evaluate(axe)
        assert page.evaluate(VIOLATIONS) == []


@pytest.mark.parametrize("scheme", SCHEMES)
def test_axe_finds_no_serious_violation_in_a_report(browser, reports, axe, scheme) -> None:
    with tab(browser, SCREEN, own=reports[0].as_uri(), scheme=scheme) as page:
        shown_report(page, reports[0])
        page.evaluate(axe)
        assert page.evaluate(VIOLATIONS) == []


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


def test_the_keyboard_reaches_every_control(browser: Any, live: Served, reports: tuple[Path, Path]) -> None:
    """Buttons, speed, the earlier moments, lists that scroll, menus with their files, whole track."""
    with tab(browser, SCREEN, own=live.url) as page:
        shown_live(page, live)
        page.focus("#moment")
        page.keyboard.press("Home")
        until(lambda: page.locator("#now:enabled").count() == 1)
        page.focus("#panel-depth summary")
        page.keyboard.press("Enter")
        until(lambda: page.locator("#panel-depth .menu button:visible").count() == 3)
        check_keyboard(page, 28)
    with tab(browser, SCREEN, own=reports[0].as_uri()) as page:
        shown_report(page, reports[0])
        check_keyboard(page, 20)


def test_after_the_end_everyone_can_use_the_page(browser, live, reports, axe) -> None:
    with tab(browser, SCREEN, own=live.url) as page, ended(live, reports[0]):
        page.goto(f"{live.url}#{live.token}")
        until(lambda: page.locator("#finished a").count() == 1)
        page.evaluate(axe)
        for scheme in SCHEMES:
            page.emulate_media(color_scheme=scheme)
            until(lambda scheme=scheme: background(page) == scheme)  # type: ignore[misc]
            assert page.evaluate(VIOLATIONS) == []
        check_keyboard(page, 18, ("Tab",))
        assert page.locator("#finished [data-reach]").count() == 2


@pytest.mark.parametrize("what", ["live page", "report"])
def test_text_of_twice_the_size_loses_nothing(large_letters, live, reports, what) -> None:
    own = live.url if what == "live page" else reports[0].as_uri()
    with tab(large_letters, SCREEN, own=own) as page:
        if what == "live page":
            shown_live(page, live)
        else:
            shown_report(page, reports[0])
        assert page.evaluate("getComputedStyle(document.querySelector('h1')).fontSize") == "32px"
        assert page.evaluate("getComputedStyle(document.querySelector('#plot-depth .xtitle')).fontSize") == "22px"
        for _ in looks(page):
            assert page.locator(".panel h3").count() > 10
