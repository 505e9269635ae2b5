"""Live page and report can be used by keyboard, with text of twice the size, and by readers of a screen (axe-core).

axe-core comes from npm, by ``npm ci --prefix tests/browser``. Without it its tests skip; with REQUIRE_AXE=1 they fail.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from tests.browser.conftest import SCHEMES, SCREEN, fits, tab
from tests.services.dashboard.synthetic_vehicle import Served, until

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

FOCUSED = "document.activeElement.dataset.reach === undefined ? -1 : Number(document.activeElement.dataset.reach)"

OUTLINED = "getComputedStyle(document.activeElement).outlineStyle !== 'none'"

TWICE = """new MutationObserver((_, seen) => {
  if (!document.documentElement) return;
  document.documentElement.style.fontSize = "200%";
  seen.disconnect();
}).observe(document, { childList: true });"""
"""Set the size of text before anything is drawn."""

CUT_OFF = """() => [...document.querySelectorAll("body *")]
  .filter(one => one.checkVisibility() && one.textContent.trim() && !one.closest("svg, .hidden, .js-plotly-plot"))
  .filter(one => ["hidden", "clip"].includes(getComputedStyle(one).overflowX) && one.scrollWidth > one.clientWidth + 1)
  .map(one => one.textContent.trim())"""
"""Words of which a part is not shown."""


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
def test_axe_finds_no_serious_violation_in_a_report(
    browser: Any, reports: tuple[Path, Path], axe: str, scheme: str
) -> None:
    with tab(browser, SCREEN, own=reports[0].as_uri(), scheme=scheme) as page:
        shown_report(page, reports[0])
        page.evaluate(axe)
        assert page.evaluate(VIOLATIONS) == []


def reached(page: Any) -> tuple[set[int], int]:
    """Return the controls that the tab key reaches with a visible outline, and the number of all."""
    number = page.evaluate(CONTROLS)
    found = set()
    for _ in range(number + 10):
        page.keyboard.press("Tab")
        if page.evaluate(OUTLINED):
            found.add(page.evaluate(FOCUSED))
    return found - {-1}, number


def test_the_keyboard_reaches_every_control(browser: Any, live: Served, reports: tuple[Path, Path]) -> None:
    with tab(browser, SCREEN, own=live.url) as page:
        shown_live(page, live)
        found, number = reached(page)
        assert number > 15
        assert found == set(range(number))
    with tab(browser, SCREEN, own=reports[0].as_uri()) as page:
        shown_report(page, reports[0])
        found, number = reached(page)
        assert number > 10
        assert found == set(range(number))


@pytest.mark.parametrize("size", [SCREEN, (768, 1024)], ids=["screen", "tablet"])
@pytest.mark.parametrize("what", ["live page", "report"])
def test_text_of_twice_the_size_loses_nothing(
    browser: Any, live: Served, reports: tuple[Path, Path], size: tuple[int, int], what: str
) -> None:
    """All letters grow as with the browser's own setting, and the page stays as wide as the window."""
    own = live.url if what == "live page" else reports[0].as_uri()
    with tab(browser, size, own=own) as page:
        page.add_init_script(TWICE)
        if what == "live page":
            shown_live(page, live)
        else:
            shown_report(page, reports[0])
        assert page.evaluate("getComputedStyle(document.querySelector('h1')).fontSize") == "32px"
        assert page.evaluate("getComputedStyle(document.querySelector('#plot-depth .xtitle')).fontSize") == "22px"
        fits(page, size)
        assert page.evaluate(CUT_OFF) == []
