"""Report in a real browser, on a screen and on a phone: drawn, readable, offline, and its tables and files work."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from services.cli import app
from services.reporting.plots.catalogue import PLOTS
from services.reporting.plots.description import Group
from tests.browser.conftest import LOCKSTEP, PHONE, SCREEN, SETTLED, background, drawn, fits, looks, tab
from tests.waiting import until

PICTURES = {0: ("SVG", b"<svg"), 4: ("PNG", b"\x89PNG")}
"""Which picture is saved of a plot, by its number modulo 8, and how its file begins: drawing them takes longest."""

UNTIMED = ("latency", "stages")
"""Plots of what lock step does not measure."""


@pytest.fixture(scope="module")
def shown(browser: Any, report: Path) -> Iterator[Any]:
    """Open the report of one run on a phone; its tests change nothing that another one looks at."""
    with tab(browser, PHONE, own=report.as_uri(), scheme="dark") as page:
        page.goto(report.as_uri())
        assert background(page) == "dark"
        yield page


def test_a_run_s_report_shows_every_plot_at_every_size(shown: Any) -> None:
    for _ in looks(shown):
        drawn(shown, but=UNTIMED)
    for name in UNTIMED:
        assert "in lock step" in shown.locator(f"#plot-{name}").text_content()  # where nothing takes any time
    assert shown.locator("#figures tr").count() > 10
    assert shown.locator("h2").all_inner_texts() == [group.value for group in Group]
    assert "arm accepted" in shown.inner_text(".events")


@pytest.mark.usefixtures("without_report")
def test_the_report_of_two_runs_shows_both(browser: Any, report: Path, tmp_path: Path) -> None:
    two, both = tmp_path / "two", tmp_path / "both" / "report.html"
    assert app.run([*LOCKSTEP, "--duration-s", "2", "--no-control", "--out", str(two)]) == 0
    assert app.run(["report", str(report.parent), str(two), "--out", str(both.parent)]) == 0
    with tab(browser, SCREEN, own=both.as_uri()) as page:
        page.goto(both.as_uri())
        drawn(page, but=tuple(one.name for one in PLOTS if not any(series.compared for series in one.series)) + UNTIMED)
        assert page.locator("#runs li").all_inner_texts() == ["ten", "two"]
        colours = page.evaluate("[...document.querySelectorAll('#plot-track .js-line')].map(one => one.style.stroke)")
        assert len(set(colours)) == 2
        fits(page)
        page.set_viewport_size({"width": PHONE[0], "height": PHONE[1]})
        until(lambda: page.evaluate(SETTLED))
        fits(page)


def saved(page: Any, menu: Any, kind: str) -> bytes:
    """Press the button of an open menu and return the file that it saves."""
    with page.expect_download() as download:
        menu.get_by_role("button").filter(has_text=kind).click()
    assert download.value.suggested_filename.endswith(f".{kind.lower()}")
    return Path(download.value.path()).read_bytes()


def test_every_plot_of_a_report_is_saved_as_csv_and_some_as_png_or_svg(browser: Any, shown: Any) -> None:
    """A CSV has a column with a name of its own for each edge of a band, and as many cells in each row."""
    shown.set_viewport_size({"width": SCREEN[0], "height": SCREEN[1]})
    until(lambda: shown.evaluate(SETTLED))
    menus = shown.locator(".menu").all()
    assert len(menus) > len(PLOTS)
    above = b""  # of the view from above, which is the first and has the longest legend
    for number, menu in enumerate(menus):
        menu.locator("summary").click()
        if number % 8 in PICTURES:
            kind, begins = PICTURES[number % 8]
            content = saved(shown, menu, kind)
            assert content.startswith(begins)
            assert len(content) > 3000
            above = above or content
        lines = saved(shown, menu, "CSV").decode().splitlines()
        assert len({line.count(",") for line in lines[1:]}) <= 1
        if "panel-errors" in str(menu.evaluate("one => one.closest('section').id")):
            of = "2 sigma of the estimate"
            assert lines[0].startswith(f'"{of} time (s)","{of} error (m)","{of}, other edge error (m)"')
            _, low, high = (float(cell) for cell in lines[5].split(",")[:3])
            assert low == -high
        menu.locator("summary").click()
    with tab(browser, SCREEN, own="about:blank") as page:
        page.set_content(above.decode())
        boxes = [page.locator(part).bounding_box() for part in (".gtitle", "g.cartesianlayer", ".xtitle", "g.legend")]
        assert all(upper["y"] + upper["height"] <= lower["y"] for upper, lower in pairwise(boxes))


def test_a_table_is_sorted_by_its_column_and_rows_without_a_value_stay_last(shown: Any) -> None:
    cells = "rows => rows.map(row => row.cells[1].textContent)"
    shown.evaluate("document.querySelector('#figures tbody tr td:nth-child(2)').textContent = '-'")
    head = shown.locator("#figures button.sort").nth(1)
    orders = []
    for _ in range(2):
        head.click()
        *values, missing = shown.locator("#figures tbody tr").evaluate_all(cells)
        assert missing == "-"
        orders.append([float(value) for value in values])
    assert orders[0] == sorted(orders[0])
    assert orders[1] == sorted(orders[0], reverse=True)
    assert orders[0][0] < orders[0][-1]
