"""Live page in a real browser, on a screen and on a phone: drawn, readable, offline, and its buttons work.

Needs chromium or chrome on PATH. Without one these tests skip; with REQUIRE_BROWSER=1 they fail.
"""

from __future__ import annotations

from collections.abc import Iterator
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
from tests.browser.conftest import LOOKS, PHONE, POINTS, SCREEN, background, drawn, fits, looks, tab
from tests.services.dashboard.synthetic_vehicle import Served, serving
from tests.services.reporting.synthetic_run import NODES, OFFSET, SPEED_NORTH_MPS, WRECK
from tests.waiting import until

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


def bottom(page: Any, what: str) -> float:
    edge: float = page.evaluate(f"document.querySelector('{what}').getBoundingClientRect().bottom")
    return edge


@pytest.fixture(scope="module")
def shown(browser: Any, live: Served) -> Iterator[Any]:
    """Open the page on a screen, with the token; the last test that looks at it ends the run."""
    with tab(browser, SCREEN, own=live.url) as page:
        page.goto(f"{live.url}#{live.token}")
        yield page


def shows_every_plot(page: Any, scheme: str) -> None:
    drawn(page)
    assert background(page) == scheme
    assert page.inner_text("#name") == "synthetic descent · paper"
    until(lambda: page.inner_text("#link") == "live")
    headings = [group.value for group in Group]
    assert page.locator("h2").all_inner_texts() == headings[:-1]  # the last is for reviewers
    assert page.locator("#processes td:first-child").all_inner_texts() == list(NODES)
    words = " ".join(page.inner_text("#facts").split())
    assert "clock running at 10×" in words
    assert "vehicle from the reference" in words
    assert f"fence plan keeps 3.00 m from {WRECK}" in words
    assert page.locator("#events tr").count() > 0
    fits(page)


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


def test_without_the_token_the_page_is_read_only_and_it_connects_again_by_itself(browser: Any, live: Served) -> None:
    with tab(browser, PHONE, own=live.url, scheme="dark") as page:
        page.goto(live.url)
        shows_every_plot(page, "dark")
        assert page.locator("#buttons button:enabled, [data-kill]").count() == 0
        assert "read-only" in page.inner_text("#reply")
        live.cut()
        page.locator("#link", has_text="not connected").wait_for()
        fits(page)
        until(lambda: page.inner_text("#link") == "live")
        drawn(page)


def test_the_live_page_shows_every_plot_and_the_state_at_the_first_look(live: Served, shown: Any) -> None:
    shows_every_plot(shown, "light")
    until(lambda: live.views[-2:] == [View.OPENED, View.DRAWN])
    # The first look tells whether it is safe, and begins to tell whether it is on its line.
    assert bottom(shown, "#panel-status") < bottom(shown, "#panel-tracking") <= SCREEN[1]
    shown.evaluate(MANY_EVENTS)
    assert bottom(shown, "#panel-tracking") <= SCREEN[1]  # the list of events scrolls


def test_the_buttons_do_what_they_say(live: Served, shown: Any) -> None:
    vehicle = live.vehicle
    shown.click("[data-button=stop]")
    until(lambda: shown.inner_text("#reply") == "stop: accepted; command authority: controller")
    shown.click("[data-button=kick]")
    shown.click("[data-kill=controller]")
    until(lambda: vehicle.received_of(Disturbance) and vehicle.received_of(Kill))
    shown.select_option("#speed", "5")
    until(lambda: vehicle.received_of(ClockCommand))
    shown.click("text=Pause")
    shown.click("text=Resume")
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


def test_the_reader_can_look_back_and_return(shown: Any) -> None:
    """At an earlier moment the hull lies where it was then, and time plots mark the moment.

    What is drawn is compared with the time and the age that the page shows, because a busy machine draws seconds late.
    """
    drawn(shown)
    until(lambda: shown.evaluate(SPAN_S) > 20)
    shown.focus("#moment")
    shown.keyboard.press("Home")
    then_s = float(shown.inner_text("#at").removeprefix("t = ").removesuffix(" s"))
    hull = Vehicle.load("paper").hull
    assert hull is not None
    age_s = float(shown.inner_text("#ages span:nth-child(2)").removeprefix("estimate ").removesuffix(" s"))
    north_m = OFFSET[0] + SPEED_NORTH_MPS * (then_s - age_s) + hull.length_m / 2
    until(lambda: hull_north_m(shown) == pytest.approx(north_m, abs=0.02))
    until(lambda: shown.evaluate("document.querySelector('#plot-depth').layout.shapes.length") == 1)
    for _ in looks(shown, LOOKS[-1:]):  # the narrowest
        assert shown.inner_text("#at") == f"t = {then_s:.1f} s"
        assert f"{then_s:.1f} s" in shown.inner_text("#facts")
    shown.click("#now")
    until(lambda: hull_north_m(shown) > north_m + 20 * SPEED_NORTH_MPS)
    assert shown.inner_text("#at") == "now"


def test_the_view_from_above_follows_the_vehicle_or_shows_the_whole_track(shown: Any) -> None:
    until(lambda: shown.evaluate(POINTS, ["track"]) > 100)
    width = "(() => { const [a, b] = document.querySelector('#plot-track').layout.yaxis.range; return b - a })()"
    shown.click("#panel-track button:text-is('whole track')")
    until(lambda: shown.locator("#panel-track button:text-is('follow')").count() == 1)
    until(lambda: shown.evaluate(width) > 6)


def test_after_the_end_of_a_run_the_page_says_so_and_keeps_the_report(live, report, shown) -> None:
    until(lambda: shown.locator("#buttons button:enabled").count() > 0)
    live.vehicle.finished = True
    until(lambda: shown.inner_text("#link") == "finished")
    assert str(live.report) in shown.inner_text("#finished")
    assert "ltv-mpc sim one" in shown.inner_text("#finished")
    assert shown.locator("#finished a").count() == 0
    live.report.write_bytes(report.read_bytes())
    until(lambda: shown.locator("#finished a").count() == 1)
    until(lambda: live.views[-1] is View.HAS_REPORT)
    live.cut()
    until(lambda: shown.inner_text("#link") == "finished")
    shown.focus("#moment")
    shown.keyboard.press("Home")
    until(lambda: shown.inner_text("#at").startswith("t = "))
    for _ in looks(shown, LOOKS[1:]):
        assert shown.locator("#buttons button:enabled, [data-kill]:visible").count() == 0
        assert shown.locator("#finished a, #finished button").evaluate_all(IN_WINDOW) == 2
    opened: list[str] = []
    shown.on("websocket", lambda socket: opened.append(socket.url))
    shown.wait_for_timeout(1500)  # longer than the page waits before it connects again
    assert opened == []
    wrong: list[str] = []
    with shown.expect_popup() as popup:
        shown.get_by_role("link", name="Open the report").click()
    popup.value.on("console", lambda message: wrong.append(message.text))
    popup.value.locator("#plot-track .xtitle").wait_for()
    popup.value.close()
    assert wrong == []
    the_command_is_copied_or_selected(shown, live.url)


def the_command_is_copied_or_selected(page: Any, url: str) -> None:
    """Check that the command which runs it again is copied, or where the browser refuses, selected."""
    page.context.grant_permissions(["clipboard-read", "clipboard-write"], origin=url)
    page.get_by_role("button", name="Copy the command").focus()
    page.keyboard.press("Enter")
    until(lambda: page.inner_text("#again output") == "copied")
    assert page.evaluate("navigator.clipboard.readText()") == "ltv-mpc sim one"
    page.evaluate("Object.defineProperty(navigator, 'clipboard', { value: undefined })")  # a page of another host
    page.keyboard.press("Enter")
    until(lambda: page.inner_text("#again output").startswith("selected"))
    assert page.evaluate("getSelection().toString()") == "ltv-mpc sim one"
