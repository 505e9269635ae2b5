"""Terminal output of a run: a live screen of 80 x 24 characters, or a plain line every few seconds without one."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from ltv_mpc.errors import one_line
from ltv_mpc.messages import ControllerStatus, LocalisationReport, SensorStatus
from services.reporting.plots.collector import Collector
from services.runtime.console import WIDTH, fold
from services.supervisor.screen import LiveView, Screen, in_order

Limits = Sequence[tuple[float, float]]
"""Minimum and maximum thrust (N) of port, starboard, vertical; empty if they are not known."""

REDRAW_S = 0.125
LINE_S = 5.0
PROGRESS = 12  # width of the bar of the time, in characters
BAR = 31  # width in characters, from full astern to full ahead
THRUSTERS = ("port", "starboard", "vertical")


def _text(text: str = "", **style: Any) -> Text:
    """Return a line of rich, which itself shows control characters of messages as they are."""
    return Text(one_line(text), **style)


def screen_for(title: str, limits: Limits, console: Console | None = None) -> Screen:
    """Return a live screen if stderr is a terminal; plain lines if it is a pipe, or NO_COLOR or CI is set."""
    console = console or Console(stderr=True)
    return PlainScreen(console) if _plain(console) else LiveScreen(title, limits, console)


def _plain(console: Console) -> bool:
    return "NO_COLOR" in os.environ or "CI" in os.environ or not console.is_terminal


class LiveScreen:
    """Live screen that is redrawn in place."""

    def __init__(self, title: str, limits: Limits, console: Console) -> None:
        self._title = title
        self._limits = limits
        self._collector = Collector()
        self._live = Live(console=console, auto_refresh=False, vertical_overflow="crop")
        self._live.start()
        self._next = 0.0
        self._waiting: Progress | None = None

    def update(self, view: LiveView) -> None:
        """Draw the view, at most eight times a second."""
        observe(self._collector, view)
        now = time.monotonic()
        if now >= self._next:
            self._next = now + REDRAW_S
            self._live.update(self.render(view), refresh=True)

    def wait(self, what: str, share: float) -> None:
        """Show a progress bar with the time left in place of the screen."""
        if self._waiting is None:
            self._waiting = Progress(*_columns(), console=self._live.console)
            self._waiting.add_task(escape(one_line(what)), total=1.0)
        now = time.monotonic()
        if now >= self._next:
            self._next = now + REDRAW_S
            self._waiting.update(self._waiting.task_ids[0], completed=share, description=escape(what))
            self._live.update(self._waiting.get_renderable(), refresh=True)

    def say(self, text: str) -> None:
        """Print a note above the screen."""
        self._live.console.print(Text(fold(one_line(text), self._live.console.width)), soft_wrap=True)

    def close(self) -> None:
        """Stop redrawing and leave the last screen visible."""
        self._live.stop()

    def render(self, view: LiveView) -> Group:
        """Return the complete screen."""
        return Group(
            _text(self._title, style="bold", no_wrap=True, overflow="ellipsis"),
            _progress(view),
            _text(),
            *_motion(view, self._collector),
            *_localisation(view),
            _text(),
            *_thrusts(view, self._limits),
            _text(),
            *_ages(view),
            _text(),
            _processes(view),
        )


class PlainScreen:
    """Plain output: one line every ``LINE_S``."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._collector = Collector()
        self._next = 0.0

    def update(self, view: LiveView) -> None:
        """Print the state of the run if ``LINE_S`` has passed since the last line."""
        observe(self._collector, view)
        now = time.monotonic()
        if now >= self._next:
            self._next = now + LINE_S
            self.say(line(view, self._collector))

    def wait(self, what: str, share: float) -> None:
        """Print the progress if ``LINE_S`` has passed since the last line."""
        now = time.monotonic()
        if now >= self._next:
            self._next = now + LINE_S
            self.say(f"{what}: {share:.0%}")

    def say(self, text: str) -> None:
        """Print a line."""
        self._console.print(_text(text), soft_wrap=True)

    def close(self) -> None:
        """Do nothing: plain output has nothing to restore."""


@contextmanager
def run_progress_bar(start_ns: int, end_ns: int, console: Console | None = None) -> Iterator[Callable[[int], None]]:
    """Show the progress of a lock-step run on stderr, if it is a terminal; call the result with the vehicle time."""
    with progress_bar(f"t {_seconds(start_ns)} s", console) as progress:
        span_ns = max(1, end_ns - start_ns)
        yield lambda t_ns: progress((t_ns - start_ns) / span_ns, f"t {_seconds(t_ns)} s")


@contextmanager
def progress_bar(what: str, console: Console | None = None) -> Iterator[Callable[..., None]]:
    """Show a bar with the time left on stderr, if it is a terminal.

    Call the result with the share done, 0 .. 1, and a new text if there is one.
    """
    console = console or Console(stderr=True)
    with Progress(*_columns(), console=console, transient=True, disable=_plain(console)) as bars:
        task = bars.add_task(escape(one_line(what)), total=1.0)
        yield lambda share, text=what: bars.update(task, completed=share, description=escape(one_line(text)))


@contextmanager
def reading_progress(what: object) -> Iterator[None]:
    """Show a bar with the time left on stderr while recordings are read, one after the other."""
    from services.recording.records import report_progress

    with progress_bar(str(what)) as progress, report_progress(progress):
        yield


def _columns() -> tuple[ProgressColumn, ...]:
    """Return the columns of a progress bar with the time left."""
    return TextColumn("{task.description}"), BarColumn(40), TaskProgressColumn(), TimeRemainingColumn()


def line(view: LiveView, collector: Collector) -> str:
    """Format the state of the run in one line."""
    end = "" if view.end_ns is None else f" of {_seconds(view.end_ns)}"
    words = [f"t {_seconds(view.t_ns)} s{end}", view.phase]
    if view.estimate is not None and view.estimate.depth_m is not None:
        words.append(f"depth {round(view.estimate.depth_m, 1) + 0.0:.1f} m")
    if collector.error_m is not None:
        words.append(f"estimate from the reference {_metres(collector.error_m)}")
    if collector.true_error_m is not None:
        words.append(f"vehicle from the reference {_metres(collector.true_error_m)}{_since(collector)}")
    if view.localisation is not None:
        words.append(f"filter {_filter(view.localisation)}")
    if view.applied is not None:
        words.append("thrust " + " ".join(f"{x:z.0f}" for x in view.applied.thrust_N) + " N")
    if view.timing is not None:
        words.append(f"cycle {view.timing.compute_wall_ns / 1e6:.1f} ms")
    words.append(f"late {view.applied.plans_late if view.applied else 0}")
    words.append(f"dropped {sum(s.dropped for s in view.status.values())}")
    words.append(f"rejected {sum(s.rejected for s in view.status.values())}")
    waiting = [f"{name} waits for {s.waiting_for}" for name, s in view.status.items() if s.waiting_for]
    return "  ".join([*words, *waiting])


def bar(thrust_N: float, min_N: float, max_N: float, width: int = BAR) -> str:
    """Draw a thrust as a bar from the middle, to the left for astern and to the right for ahead: ``|   ===+     |``."""
    half = width // 2
    bound = max_N if thrust_N > 0 else -min_N
    filled = min(half, round(half * abs(thrust_N) / bound)) if bound > 0 else 0
    left = "=" * filled if thrust_N < 0 else ""
    right = "=" * filled if thrust_N > 0 else ""
    return f"|{left:>{half}}+{right:<{half}}|"


def times(speed: float, asked: float) -> str:
    """Format the speed of the clock: ``10x``, or ``3.1 of 10x`` if the machine cannot keep the requested speed."""
    return f"{asked:g}x" if speed == asked else f"{speed:.3g} of {asked:g}x"


def _progress(view: LiveView) -> Text:
    if view.end_ns is None:
        t = "-" if view.estimate is None and not view.status else f"{_seconds(view.t_ns)} s"
        return _text(f"t {t:>10}  {view.phase}", no_wrap=True, overflow="ellipsis")
    share = (view.t_ns - view.start_ns) / max(1, view.end_ns - view.start_ns)
    done = round(PROGRESS * min(max(share, 0.0), 1.0))
    return _text(
        f"t {_seconds(view.t_ns):>8} s of {_seconds(view.end_ns)}  [{'#' * done:<{PROGRESS}}]"
        f"  {times(view.speed, view.requested_speed)}  {view.phase}  wall time {view.wall_s:.0f} s",
        no_wrap=True,
    )


def _motion(view: LiveView, collector: Collector) -> list[Text]:
    """Return where the vehicle is by its estimate, how far from the reference, and who controls it in which health."""
    estimate, controller = view.estimate, view.controller
    if estimate is None:
        return [_text("motion  no estimate yet"), _text("error   -"), _text(f"control {_control(controller)}")]
    depth = "" if estimate.depth_m is None else f"depth {round(estimate.depth_m, 2) + 0.0:.2f} m   "
    speed_mps = math.hypot(estimate.velocity_north_mps, estimate.velocity_east_mps)
    words = f"{depth}heading {round(math.degrees(estimate.heading_rad)) % 360} deg   speed {speed_mps:.3f} m/s"
    if (current := estimate.current) is not None:
        at = (estimate.depth_m or 0.0, current.depth_m)
        current_mps = math.hypot(np.interp(*at, current.north_mps), np.interp(*at, current.east_mps))
        words += f"   current {current_mps:.3f} m/s"
    error = f"estimate from the reference {_metres(collector.error_m)}"
    if view.truth is not None:
        error += f"   vehicle from the reference {_metres(collector.true_error_m)}"
        if "since_s" in collector.values:  # the screen joined the run late; 80 columns
            error = error.replace("vehicle from the reference", "vehicle") + _since(collector)
    lines = [f"motion  {words}", f"error   {error}", f"control {_control(controller)}"]
    return [_text(line, no_wrap=True, overflow="ellipsis") for line in lines]


def _control(controller: ControllerStatus | None) -> str:
    if controller is None:
        return "no status of a controller yet"
    why = f" ({controller.health_why})" if controller.health_why else ""
    progress = "" if controller.progress is None else f"   progress {100 * controller.progress:.0f} %"
    progress = "   arrived" if controller.arrived else progress
    return f"{controller.authority}   {controller.health}{why}{progress}"


def _localisation(view: LiveView) -> list[Text]:
    """Return the line of the localisation filter; a vehicle with a navigation of its own has none."""
    if view.localisation is None and view.end_ns is None:
        return []
    return [_text(f"filter  {_filter(view.localisation)}", no_wrap=True, overflow="ellipsis")]


def _filter(report: LocalisationReport | None) -> str:
    """Return the status of the localisation filter, its reason, and the sensors that are not ok."""
    if report is None:
        return "-"
    wrong = [f"{one.sensor} {one.status}" for one in report.sensors if one.status is not SensorStatus.OK]
    why = f" ({report.why})" if report.why else ""
    return "   ".join([f"{report.status}{why}", *wrong])


def _thrusts(view: LiveView, limits: Limits) -> list[Text]:
    """Return a line for each thruster: its force, and a bar if its limits are known. A surface craft has two."""
    dives = any(limits[2]) if limits else view.estimate is None or view.estimate.depth_m is not None
    names = THRUSTERS if dives else THRUSTERS[:2]
    if view.applied is None:
        return [_text(f"{name:<10}{'-':>8} N") for name in names]
    lines = []
    for i, (name, thrust_N) in enumerate(zip(names, view.applied.thrust_N, strict=False)):
        text, style = f"{name:<10}{thrust_N:z8.1f} N", ""
        if limits:
            least, most = limits[i]
            text += f"  {bar(thrust_N, least, most)}"
            if thrust_N >= 0.999 * most or thrust_N <= 0.999 * least:
                style = "yellow"
        lines.append(_text(text, style=style))
    return lines


def _ages(view: LiveView) -> list[Text]:
    estimate = "-" if view.estimate is None else f"{_seconds(view.t_ns - view.estimate.t_ns, 2)} s"
    plan = "-" if view.plan is None else f"{_seconds(view.t_ns - view.plan.cycle_t_ns, 2)} s ({view.plan.origin})"
    late = view.applied.plans_late if view.applied else 0
    lines = [f"age     estimate {estimate}   plan {plan}   late plans {late}"]
    if view.timing is None:
        lines.append("cycle   -")
    else:
        words = f"cycle   {view.timing.compute_wall_ns / 1e6:.1f} ms, most of it:"
        for name, us in sorted(view.timing.stage_us.items(), key=lambda stage: -stage[1])[:4]:
            stage = f"  {name} {us / 1000:.2f}"
            words += stage if len(words) + len(stage) <= WIDTH else ""
        lines.append(words)
    return [_text(text, no_wrap=True, overflow="ellipsis") for text in lines]


def _processes(view: LiveView) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim", width=79)
    table.add_column("process")
    table.add_column("state", no_wrap=True, overflow="ellipsis", ratio=1)
    for name in ("steps", "sent", "received", "dropped", "rejected", "us/step"):
        table.add_column(name, justify="right")
    states = {**dict.fromkeys(view.status, ""), **view.state}
    for name, state in in_order(states):
        status = view.status.get(name)
        if status is None:
            table.add_row(_text(name), _text(state), *[""] * 6)
            continue
        if status.waiting_for:
            state = f"waits for {status.waiting_for}"
        counts = (status.steps, status.published, status.received, status.dropped, status.rejected)
        bad = "yellow" if status.dropped or status.rejected else ""
        table.add_row(_text(name), _text(state), *(str(x) for x in counts), f"{status.step_us:.0f}", style=bad)
    return table


def observe(collector: Collector, view: LiveView) -> None:
    """Pass a view to the collector of the plots, for the distance that page and report show too."""
    for message in (view.truth, view.estimate, view.plan):
        if message is not None:
            collector.add(message, epoch=0)


def _since(collector: Collector) -> str:
    """Return since when a distance counts, if the screen joined the run late."""
    since_s = collector.values.get("since_s")
    return "" if since_s is None else f" since t = {since_s:g} s"


def _seconds(t_ns: int, digits: int = 1) -> str:
    return f"{t_ns / 1e9:z.{digits}f}"


def _metres(distance: float | None) -> str:
    return "- m" if distance is None else f"{distance:.3f} m"
