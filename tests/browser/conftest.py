"""A real browser, and what it looks at: the report of a short run, and the live page of a synthetic vehicle.

Needs chromium or chrome on PATH. Without one the tests of this folder skip; with REQUIRE_BROWSER=1 they fail.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from services.cli import app
from services.reporting.plots.catalogue import PLOTS
from services.supervisor import loopback
from tests.services.dashboard.synthetic_vehicle import Served, served
from tests.waiting import until

SCREEN, TABLET, PHONE = (1280, 800), (768, 1024), (390, 844)
SCHEMES = ["light", "dark"]
LOOKS = ((SCREEN, "light"), (TABLET, "dark"), (PHONE, "light"))
"""Every size of the window and both colour schemes: no size depends on the scheme, and no colour on the size."""

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PATIENCE_MS = 120_000

UNFIT = """() => {
  scrollTo(0, 0);  // else the header lies over what has been scrolled
  const wide = document.documentElement.clientWidth, wrong = [];
  if (document.documentElement.scrollWidth > wide) wrong.push("the page scrolls sideways");

  // What is seen of a box in a list that scrolls; null if nothing.
  const seen = (box, one) => {
    const list = one.closest(".scroll")?.getBoundingClientRect() ?? box;
    const left = Math.max(box.left, list.left), right = Math.min(box.right, list.right);
    const top = Math.max(box.top, list.top), bottom = Math.min(box.bottom, list.bottom);
    return right > left && bottom > top ? { one, left, right, top, bottom } : null;
  };
  const parts = [];
  const hidden = ".hidden, .js-plotly-plot, script, style, option";
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const text = walker.currentNode, one = text.parentElement;
    if (!text.data.trim() || one.closest(hidden) || !one.checkVisibility({ visibilityProperty: true })) continue;
    const range = document.createRange();
    range.selectNodeContents(text);
    const within = one.closest("button, .panel, header, main").getBoundingClientRect();
    for (const line of range.getClientRects()) {
      const outside = line.left < within.left - 1 || line.right > Math.min(wide, within.right) + 1;
      if (outside && !one.closest("table")) wrong.push(`outside: ${text.data}`);
      parts.push(seen(line, one));
    }
  }
  for (const one of document.querySelectorAll("button, select, input, summary, a")) {
    if (!one.checkVisibility({ visibilityProperty: true })) continue;
    const box = one.getBoundingClientRect(), list = one.closest(".scroll")?.getBoundingClientRect();
    const cut = list && (box.right > list.right || box.bottom > list.bottom);
    if (box.left < 0 || box.right > wide || cut) wrong.push(`outside: ${one.outerHTML}`);
    if (one.scrollWidth > one.clientWidth && one.clientWidth) wrong.push(`cut: ${one.outerHTML}`);
    parts.push(seen(box, one));
  }
  for (const one of document.querySelectorAll("body *")) {
    const clips = ["hidden", "clip"].includes(getComputedStyle(one).overflowX);
    if (clips && one.checkVisibility() && one.scrollWidth > one.clientWidth + 1 && !one.closest(`svg, ${hidden}`)) {
      wrong.push(`cut: ${one.textContent.trim()}`);
    }
  }
  const boxes = parts.filter(box => box !== null);
  boxes.forEach((a, i) => boxes.slice(0, i).forEach((b) => {
    const width = Math.min(a.right, b.right) - Math.max(a.left, b.left);
    const height = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    if (width <= 1 || height <= 3 || a.one.contains(b.one) || b.one.contains(a.one)) return;
    wrong.push(`overlap: ${a.one.outerHTML} and ${b.one.outerHTML}`);
  }));
  for (const title of document.querySelectorAll(".xtitle, .ytitle")) {
    const box = title.getBoundingClientRect(), plot = title.closest(".plot").getBoundingClientRect();
    const over = Math.max(plot.left - box.left, box.right - plot.right, plot.top - box.top, box.bottom - plot.bottom);
    if (over > 1) wrong.push(`cut: axis ${title.textContent}`);
  }
  return wrong;
}"""
"""What a reader cannot see or use: words and controls that are cut, outside the window or over each other."""


def executable() -> str | None:
    """Return the path of the first browser that is installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@pytest.fixture(scope="module")
def launch() -> Iterator[Callable[..., Any]]:
    """Return a function that starts a browser with an option of its own."""
    path = executable()
    missing = "" if path else f"no browser: none of {', '.join(NAMES)} is on PATH"
    if find_spec("playwright") is None:
        missing = "no browser: playwright is not installed"
    if missing and os.environ.get("REQUIRE_BROWSER") == "1":
        pytest.fail(missing)
    if missing:
        pytest.skip(missing)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play, ExitStack() as opened:

        def start(*options: str) -> Any:
            started = play.chromium.launch(executable_path=path, args=["--no-sandbox", *options])
            opened.callback(started.close)
            return started

        yield start


@pytest.fixture(scope="module")
def browser(launch: Callable[..., Any]) -> Any:
    return launch()


@pytest.fixture(scope="module")
def large_letters(launch: Callable[..., Any]) -> Any:
    """Return a browser whose reader has set letters of twice the size."""
    return launch("--blink-settings=defaultFontSize=32")


LOCKSTEP = ("sim", "--lockstep", "--surface-time-s", "1", "--json")


@pytest.fixture(scope="module")
def report(browser: object, tmp_path_factory: pytest.TempPathFactory) -> Path:  # noqa: ARG001  (skips first)
    """Return the report of a 10 s run in lock step."""
    folder = tmp_path_factory.mktemp("runs") / "ten"
    assert app.run([*LOCKSTEP, "--duration-s", "10", "--out", str(folder)]) == 0
    return folder / "report.html"


@pytest.fixture(scope="module")
def live(browser: object) -> Iterator[Served]:  # noqa: ARG001  (skips first)
    with served(loopback.free_port()) as made:
        yield made


@contextmanager
def tab(browser: Any, size: tuple[int, int], *, own: str, scheme: str = "light") -> Iterator[Any]:
    """Open a page that fails on any console message and on any request to a host other than ``own``."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)
    page.context.set_default_timeout(PATIENCE_MS)  # of what it opens, too
    wrong: list[str] = []
    page.on("console", lambda message: wrong.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda asked: None if asked.url.startswith((own, "data:", "blob:")) else wrong.append(asked.url))
    page.on("websocket", lambda opened: None if own.split("/")[2] in opened.url else wrong.append(opened.url))
    try:
        yield page
    finally:
        page.close()  # else it goes on drawing
    assert wrong == []


def fits(page: Any) -> None:
    """Check that the reader sees and reaches everything at this size of the window.

    A plot makes room for the letters of its axes in a second step, after it has the size of its place.
    """
    wrong: list[str] = []

    def nothing_is_wrong() -> bool:
        wrong[:] = page.evaluate(UNFIT)
        return wrong == []

    with suppress(AssertionError):
        until(nothing_is_wrong)
    assert wrong == []


POINTS = """names => Math.min(...names.map((name) => {
  const lines = [...document.querySelectorAll(`#plot-${name} .scatterlayer path`)];
  return lines.map(line => line.getAttribute("d") || "").join("").length;
}))"""
"""How much is drawn in the emptiest of these plots: the length of its paths."""

TITLES = """names => names.map(name => ["x", "y"].map(
  axis => document.querySelector(`#plot-${name} .${axis}title`).textContent
))"""
"""Labels of the axes of these plots."""


def drawn(page: Any, *, but: tuple[str, ...] = ()) -> None:
    """Wait until each plot is drawn; check the labels of its axes."""
    labels = {plot.name: [plot.x.label, plot.y.label] for plot in PLOTS if plot.name not in but}
    until(lambda: page.evaluate(POINTS, list(labels)) > 100)
    assert page.evaluate(TITLES, list(labels)) == list(labels.values())


SETTLED = """() => [...document.querySelectorAll(".plot")].every((plot) => {
  const drawn = plot.querySelector(".main-svg"), close = (a, b) => Math.abs(a - b) <= 1;
  return drawn && close(drawn.clientWidth, plot.clientWidth) && close(drawn.clientHeight, plot.clientHeight);
})"""
"""True if each plot is drawn in the size of its place: the plots follow the window one after the other."""


def background(page: Any) -> str:
    """Return "light" or "dark", by the background of the page and of a plot; "mixed" while they differ."""
    rgb = (
        page.evaluate(f"getComputedStyle(document.querySelector('{what}')).{key}")
        for what, key in (("body", "backgroundColor"), ("#plot-depth .bglayer rect, #plot-depth .bg", "fill"))
    )
    shades = {"light" if sum(map(int, re.findall(r"\d+", one)[:3])) > 384 else "dark" for one in rgb}
    return shades.pop() if len(shades) == 1 else "mixed"


def looks(page: Any, at: Sequence[tuple[tuple[int, int], str]] = LOOKS) -> Iterator[tuple[tuple[int, int], str]]:
    """Show an open page in each look, and check in each that everything fits."""
    for size, scheme in at:
        page.set_viewport_size({"width": size[0], "height": size[1]})
        page.emulate_media(color_scheme=scheme)
        until(lambda: page.evaluate(SETTLED))
        until(lambda scheme=scheme: background(page) == scheme)  # type: ignore[misc]
        fits(page)
        yield size, scheme


@contextmanager
def ended(live: Served, report: Path) -> Iterator[None]:
    """Let the synthetic run end, with this report."""
    live.vehicle.finished = True
    live.report.write_bytes(report.read_bytes())
    try:
        yield
    finally:
        live.vehicle.finished = False
        live.report.unlink(missing_ok=True)
