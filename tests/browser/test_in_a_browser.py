"""Report and live page in a real browser, on a screen and on a phone: drawn, readable, offline, and their buttons work.

Needs chromium or chrome on PATH. Without one these tests skip; with REQUIRE_BROWSER=1 they fail.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from ltv_mpc.messages import ClockCommand, Command, Disturbance, Kill
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.options import BusOptions
from services.bus.session import open_session
from services.dashboard.bus_feed import BusFeed
from services.dashboard.config import View
from services.reporting.plots.catalogue import PLOTS
from services.reporting.plots.description import NO_DATA, Group
from services.supervisor import loopback
from tests.browser.conftest import PHONE, SCREEN, SETTLED, background, ended, fits, looks, tab
from tests.services.dashboard.synthetic_vehicle import Served, serving
from tests.services.reporting.synthetic_run import NODES, OFFSET, SPEED_NORTH_MPS, WRECK
from tests.waiting import until

FRESH = [pytest.param(SCREEN, "light", id="screen"), pytest.param(PHONE, "dark", id="phone")]
"""Sizes and schemes in which the live page is opened; the other tests show an open page in all of them."""

PICTURES = {0: ("SVG", b"<svg"), 4: ("PNG", b"\x89PNG")}
"""Which picture is saved of a plot, by its number modulo 8, and how its file begins: drawing them takes longest."""

POINTS = """name => {
  const lines = document.querySelectorAll(`#plot-${name} .scatterlayer path`);
  return [...lines].map(line => line.getAttribute("d") || "").join("").length;
}"""
"""How much is drawn in a plot: the length of its paths."""

IN_WINDOW = """all => all.filter((one) => {
  const box = one.getBoundingClientRect();
  return box.width > 0 && box.top >= 0 && box.bottom <= innerHeight && box.left >= 0 && box.right <= innerWidth;
}).length"""
"""How many of these elements the reader sees without scrolling."""

SPAN_S = "Number(document.querySelector('#moment').max) - Number(document.querySelector('#moment').min)"
"""How far the reader can look back."""

MANY_EVENTS = """() => {
  const events = document.querySelector("#events");
  for (let i = 0; i < 20; i++) events.append(events.lastChild.cloneNode(true));
}"""


def drawn(page: Any, *, but: tuple[str, ...] = ()) -> None:
    for plot in PLOTS:
        if plot.name not in but:
            until(lambda name=plot.name: page.evaluate(POINTS, name) > 100)  # type: ignore[misc]
            assert page.locator(f"#plot-{plot.name} .xtitle").text_content() == plot.x.label
            assert page.locator(f"#plot-{plot.name} .ytitle").text_content() == plot.y.label


UNTIMED = ("latency", "stages")
"""Plots of what lock step does not measure."""


def bottom(page: Any, what: str) -> float:
    edge: float = page.evaluate(f"document.querySelector('{what}').getBoundingClientRect().bottom")
    return edge


# --- the report ------------------------------------------------------------------------------------------------------


def test_a_run_s_report_shows_every_plot_at_every_size(browser: Any, reports: tuple[Path, Path]) -> None:
    with tab(browser, PHONE, own=reports[0].as_uri(), scheme="dark") as page:
        page.goto(reports[0].as_uri())
        assert background(page) == "dark"
        for _ in looks(page):
            drawn(page, but=UNTIMED)
        for name in UNTIMED:
            assert "in lock step" in page.locator(f"#plot-{name}").text_content()  # where nothing takes any time
        assert page.locator("#figures tr").count() > 10
        assert page.locator("h2").all_inner_texts() == [group.value for group in Group]
        assert "arm accepted" in page.inner_text(".events")


def test_the_report_of_two_runs_shows_both(browser: Any, reports: tuple[Path, Path]) -> None:
    with tab(browser, SCREEN, own=reports[1].as_uri()) as page:
        page.goto(reports[1].as_uri())
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


def test_every_plot_of_a_report_is_saved_as_csv_and_some_as_png_or_svg(browser, reports) -> None:
    """A CSV has a column with a name of its own for each edge of a band, and as many cells in each row."""
    with tab(browser, SCREEN, own=reports[0].as_uri()) as page:
        page.goto(reports[0].as_uri())
        drawn(page, but=UNTIMED)
        menus = page.locator(".menu").all()
        assert len(menus) > len(PLOTS)
        above = b""  # of the view from above, which is the first and has the longest legend
        for number, menu in enumerate(menus):
            menu.locator("summary").click()
            if number % 8 in PICTURES:
                kind, begins = PICTURES[number % 8]
                content = saved(page, menu, kind)
                assert content.startswith(begins)
                assert len(content) > 3000
                above = above or content
            lines = saved(page, menu, "CSV").decode().splitlines()
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


def test_a_table_is_sorted_by_its_column_and_rows_without_a_value_stay_last(browser, reports) -> None:
    cells = "rows => rows.map(row => row.cells[1].textContent)"
    with tab(browser, SCREEN, own=reports[0].as_uri()) as page:
        page.goto(reports[0].as_uri())
        page.evaluate("document.querySelector('#figures tbody tr td:nth-child(2)').textContent = '-'")
        head = page.locator("#figures button.sort").nth(1)
        orders = []
        for _ in range(2):
            head.click()
            *values, missing = page.locator("#figures tbody tr").evaluate_all(cells)
            assert missing == "-"
            orders.append([float(value) for value in values])
        assert orders[0] == sorted(orders[0])
        assert orders[1] == sorted(orders[0], reverse=True)
        assert orders[0][0] < orders[0][-1]


# --- the live page ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("size", "scheme"), FRESH)
def test_the_live_page_shows_every_plot(browser: Any, live: Served, size: tuple[int, int], scheme: str) -> None:
    with tab(browser, size, own=live.url, scheme=scheme) as page:
        page.goto(f"{live.url}#{live.token}")
        drawn(page)
        assert background(page) == scheme
        assert page.inner_text("#name") == "synthetic descent · paper"
        until(lambda: page.inner_text("#link") == "live")
        until(lambda: live.views[-2:] == [View.OPENED, View.DRAWN])
        assert (
            page.locator("h2").all_inner_texts() == [group.value for group in Group][:-1]
        )  # the last is for reviewers
        assert page.locator("#processes td:first-child").all_inner_texts() == list(NODES)
        words = " ".join(page.inner_text("#facts").split())
        assert "clock running at 10×" in words
        assert "vehicle from the reference" in words
        assert f"fence plan keeps 3.00 m from {WRECK}" in words
        assert page.locator("#events tr").count() > 0
        fits(page)
        if size == SCREEN:  # the first look tells whether it is safe, and begins to tell whether it is on its line
            assert bottom(page, "#panel-status") < bottom(page, "#panel-tracking") <= size[1]
            page.evaluate(MANY_EVENTS)
            assert bottom(page, "#panel-tracking") <= size[1]  # the list of events scrolls


def test_before_there_are_data_no_plot_says_why_it_is_empty(browser: Any) -> None:
    """Whether the vehicle has a vertical thruster, or an estimator, is not known yet."""
    bus = BusOptions(listen=(f"tcp/127.0.0.1:{loopback.free_port()}",))
    with (
        open_session(bus, stop=lambda: False, say=print) as session,
        serving(BusFeed(session, None), bus) as shown,
        tab(browser, SCREEN, own=shown.url) as page,
    ):
        page.goto(f"{shown.url}#{shown.token}")
        until(lambda: page.locator(".plot .annotation-text").count() == len(PLOTS))
        assert set(page.locator(".plot .annotation-text").all_text_contents()) == {NO_DATA}
        until(lambda: page.inner_text("#link") == "connected; no data yet")
        assert page.locator("#buttons button:enabled").count() == 0
        fits(page)


def test_the_buttons_do_what_they_say(browser: Any, live: Served) -> None:
    vehicle = live.vehicle
    with tab(browser, SCREEN, own=live.url) as page:
        page.goto(f"{live.url}#{live.token}")
        page.click("[data-button=stop]")
        until(lambda: page.inner_text("#reply") == "stop: accepted; command authority: controller")
        page.click("[data-button=kick]")
        page.click("[data-kill=controller]")
        until(lambda: vehicle.received_of(Disturbance) and vehicle.received_of(Kill))
        page.select_option("#speed", "5")
        until(lambda: vehicle.received_of(ClockCommand))
        page.click("text=Pause")
        page.click("text=Resume")
        until(lambda: len(vehicle.received_of(ClockCommand)) == 3)
    assert [one.action for one in vehicle.received_of(Command)] == ["stop"]
    assert [one.node for one in vehicle.received_of(Kill)] == ["controller"]
    first, *others = vehicle.received_of(ClockCommand)
    assert (first.paused, first.speed) == (False, 5)
    assert [one.paused for one in others] == [True, False]  # at the speed that the clock says, which here never changes


def hull_north_m(page: Any) -> float:
    """Return the north end of the hull that is drawn, which points north."""
    north: float = page.evaluate(
        "Math.max(...document.querySelector('#plot-track').data.find(one => one.series.table === 'hull').y)"
    )
    return north


def test_the_reader_can_look_back_and_return(browser: Any, live: Served) -> None:
    """At an earlier moment the hull lies where it was then, and time plots mark the moment.

    What is drawn is compared with the time and the age that the page shows, because a busy machine draws seconds late.
    """
    with tab(browser, SCREEN, own=live.url) as page:
        page.goto(f"{live.url}#{live.token}")
        drawn(page)
        until(lambda: page.evaluate(SPAN_S) > 20)
        page.focus("#moment")
        page.keyboard.press("Home")
        then_s = float(page.inner_text("#at").removeprefix("t = ").removesuffix(" s"))
        hull = Vehicle.load("paper").hull
        assert hull is not None
        age_s = float(page.inner_text("#ages span:nth-child(2)").removeprefix("estimate ").removesuffix(" s"))
        north_m = OFFSET[0] + SPEED_NORTH_MPS * (then_s - age_s) + hull.length_m / 2
        until(lambda: hull_north_m(page) == pytest.approx(north_m, abs=0.02))
        until(lambda: page.evaluate("document.querySelector('#plot-depth').layout.shapes.length") == 1)
        for _ in looks(page):
            assert page.inner_text("#at") == f"t = {then_s:.1f} s"
            assert f"{then_s:.1f} s" in page.inner_text("#facts")
        page.click("#now")
        until(lambda: hull_north_m(page) > north_m + 20 * SPEED_NORTH_MPS)
        assert page.inner_text("#at") == "now"


def test_the_view_from_above_follows_the_vehicle_or_shows_the_whole_track(browser: Any, live: Served) -> None:
    with tab(browser, SCREEN, own=live.url) as page:
        page.goto(f"{live.url}#{live.token}")
        until(lambda: page.evaluate(POINTS, "track") > 100)
        width = "(() => { const [a, b] = document.querySelector('#plot-track').layout.yaxis.range; return b - a })()"
        page.click("#panel-track button:text-is('whole track')")
        until(lambda: page.locator("#panel-track button:text-is('follow')").count() == 1)
        until(lambda: page.evaluate(width) > 6)


def test_without_the_token_the_page_is_read_only_and_it_connects_again_by_itself(browser: Any, live: Served) -> None:
    with tab(browser, PHONE, own=live.url) as page:
        page.goto(live.url)
        drawn(page)
        assert page.locator("#buttons button:enabled, [data-kill]").count() == 0
        assert "read-only" in page.inner_text("#reply")
        live.cut()
        page.locator("#link", has_text="not connected").wait_for()
        fits(page)
        until(lambda: page.inner_text("#link") == "live")
        drawn(page)


def test_the_command_that_runs_it_again_is_copied_or_where_the_browser_refuses_selected(browser, live, reports) -> None:
    with tab(browser, SCREEN, own=live.url) as page, ended(live, reports[0]):
        page.context.grant_permissions(["clipboard-read", "clipboard-write"], origin=live.url)
        page.goto(f"{live.url}#{live.token}")
        page.get_by_role("button", name="Copy the command").focus()
        page.keyboard.press("Enter")
        until(lambda: page.inner_text("#again output") == "copied")
        assert page.evaluate("navigator.clipboard.readText()") == "ltv-mpc sim one"
        page.evaluate("Object.defineProperty(navigator, 'clipboard', { value: undefined })")  # a page of another host
        page.keyboard.press("Enter")
        until(lambda: page.inner_text("#again output").startswith("selected"))
        assert page.evaluate("getSelection().toString()") == "ltv-mpc sim one"


def test_after_the_end_of_a_run_the_page_says_so_and_keeps_the_report(browser, live, reports) -> None:
    with tab(browser, SCREEN, own=live.url) as page:
        page.goto(f"{live.url}#{live.token}")
        until(lambda: page.locator("#buttons button:enabled").count() > 0)
        live.vehicle.finished = True
        try:
            until(lambda: page.inner_text("#link") == "finished")
            assert str(live.report) in page.inner_text("#finished")
            assert "ltv-mpc sim one" in page.inner_text("#finished")
            assert page.locator("#finished a").count() == 0
            live.report.write_bytes(reports[0].read_bytes())
            until(lambda: page.locator("#finished a").count() == 1)
            until(lambda: live.views[-1] is View.HAS_REPORT)
            live.cut()
            until(lambda: page.inner_text("#link") == "finished")
            page.focus("#moment")
            page.keyboard.press("Home")
            until(lambda: page.inner_text("#at").startswith("t = "))
            for _ in looks(page):
                assert page.locator("#buttons button:enabled, [data-kill]:visible").count() == 0
                assert page.locator("#finished a, #finished button").evaluate_all(IN_WINDOW) == 2
            opened: list[str] = []
            page.on("websocket", lambda socket: opened.append(socket.url))
            page.wait_for_timeout(1500)  # longer than the page waits before it connects again
            assert opened == []
            wrong: list[str] = []
            with page.expect_popup() as popup:
                page.get_by_role("link", name="Open the report").click()
            popup.value.on("console", lambda message: wrong.append(message.text))
            popup.value.locator("#plot-track .xtitle").wait_for()
            popup.value.close()
            assert wrong == []
        finally:
            live.vehicle.finished = False
            live.report.unlink(missing_ok=True)
