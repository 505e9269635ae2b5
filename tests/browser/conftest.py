"""A real browser, and what it looks at: the reports of two short runs, and the live page of a synthetic vehicle.

Needs chromium or chrome on PATH. Without one the tests of this folder skip; with REQUIRE_BROWSER=1 they fail.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from services.cli import app
from services.supervisor import loopback
from tests.services.dashboard.synthetic_vehicle import Served, served

SCREEN, PHONE = (1280, 800), (390, 844)
SCHEMES = ["light", "dark"]
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PATIENCE_MS = 30_000

OUTSIDE = """() => {
  const wide = document.documentElement.clientWidth;
  return [...document.querySelectorAll("h1, h2, .legend li, td, th, button, dd")]
    .filter(one => one.getClientRects().length && one.getBoundingClientRect().right > wide + 1)
    .filter(one => !one.closest(".scroll, details:not([open])"))
    .map(one => one.textContent.trim());
}"""
"""Words that do not fit the width."""


def executable() -> str | None:
    """Return the path of the first browser that is installed."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    path = executable()
    missing = "" if path else f"no browser: none of {', '.join(NAMES)} is on PATH"
    if find_spec("playwright") is None:
        missing = "no browser: playwright is not installed"
    if missing and os.environ.get("REQUIRE_BROWSER") == "1":
        pytest.fail(missing)
    if missing:
        pytest.skip(missing)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        opened = play.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def reports(browser: object, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:  # noqa: ARG001  (skips first)
    """Return the reports of a 10 s run in lock step and of that run compared with another."""
    folder = tmp_path_factory.mktemp("runs")
    options = ["sim", "--lockstep", "--surface-time-s", "1", "--json"]
    assert app.run([*options, "--duration-s", "10", "--out", str(folder / "ten")]) == 0
    assert app.run([*options, "--duration-s", "2", "--no-control", "--out", str(folder / "two")]) == 0
    both = folder / "both"
    assert app.run(["report", str(folder / "ten"), str(folder / "two"), "--out", str(both)]) == 0
    return folder / "ten" / "report.html", both / "report.html"


@pytest.fixture(scope="module")
def live(browser: object) -> Iterator[Served]:  # noqa: ARG001  (skips first)
    with served(loopback.free_port()) as made:
        yield made


@contextmanager
def tab(browser: Any, size: tuple[int, int], *, own: str, scheme: str = "light") -> Iterator[Any]:
    """Open a page that fails on any console message and on any request to a host other than ``own``."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=scheme)
    page.set_default_timeout(PATIENCE_MS)
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


def fits(page: Any, size: tuple[int, int]) -> None:
    assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
    assert page.evaluate(OUTSIDE) == []
