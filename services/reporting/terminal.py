"""A run in the terminal: one live screen of 80 x 24, or a plain line now and then where there is no screen."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

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

from services.reporting.tracking_error import TrackingError
from services.supervisor.screen import LiveView, Screen

Limits = Sequence[tuple[float, float]]
"""Minimum and maximum thrust (N) of port, starboard, vertical."""

REDRAW_S = 0.125
LINE_S = 5.0
BAR = 31  # characters from full astern to full ahead
ORDER = ("router", "plant", "sensors", "estimator", "controller", "recorder")


def screen_for(title: str, limits: Limits, console: Console | None = None) -> Screen:
    """The screen that suits stderr: live on a terminal, plain lines where it is a pipe, or NO_COLOR or CI is set."""
    console = console or Console(stderr=True)
    return PlainScreen(console) if _plain(console) else LiveScreen(title, limits, console)


def _plain(console: Console) -> bool:
    return "NO_COLOR" in os.environ or "CI" in os.environ or not console.is_terminal


class LiveScreen:
    """One picture that is drawn over itself."""

    def __init__(self, title: str, limits: Limits, console: Console) -> None:
        self._title = title
        self._limits = limits
        self._errors = TrackingError()
        self._live = Live(console=console, auto_refresh=False, vertical_overflow="crop")
        self._live.start()
        self._next = 0.0
        self._waiting: Progress | None = None

    def update(self, view: LiveView) -> None:
        """Draw, at most eight times a second."""
        self._errors.update(view)
        now = time.monotonic()
        if now >= self._next:
            self._next = now + REDRAW_S
            self._live.update(self.render(view), refresh=True)

    def wait(self, what: str, share: float) -> None:
        """A bar with the time left where the picture will be."""
        if self._waiting is None:
            self._waiting = Progress(*_columns(), console=self._live.console)
            self._waiting.add_task(escape(what), total=1.0)
        now = time.monotonic()
        if now >= self._next:
            self._next = now + REDRAW_S
            self._waiting.update(self._waiting.task_ids[0], completed=share)
            self._live.update(self._waiting.get_renderable(), refresh=True)

    def say(self, text: str) -> None:
        """A line above the picture."""
        self._live.console.print(Text(text))

    def close(self) -> None:
        """Leave the last picture where it stands."""
        self._live.stop()

    def render(self, view: LiveView) -> Group:
        """The whole screen."""
        return Group(
            Text(self._title, style="bold", no_wrap=True, overflow="ellipsis"),
            _progress(view),
            Text(),
            *_motion(view, self._errors),
            Text(),
            *_thrusts(view, self._limits),
            Text(),
            *_ages(view),
            Text(),
            _processes(view),
        )


class PlainScreen:
    """A line every few seconds."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._errors = TrackingError()
        self._next = 0.0

    def update(self, view: LiveView) -> None:
        """A line, if the last one is long enough ago."""
        self._errors.update(view)
        now = time.monotonic()
        if now >= self._next:
            self._next = now + LINE_S
            self.say(line(view, self._errors))

    def wait(self, what: str, share: float) -> None:
        """A line, if the last one is long enough ago."""
        now = time.monotonic()
        if now >= self._next:
            self._next = now + LINE_S
            self.say(f"{what}: {share:.0%}")

    def say(self, text: str) -> None:
        """A line."""
        self._console.print(Text(text), soft_wrap=True)

    def close(self) -> None:
        """Nothing to restore."""


@contextmanager
def run_progress_bar(start_ns: int, end_ns: int, console: Console | None = None) -> Iterator[Callable[[int], None]]:
    """A bar on stderr for a run in lock step, told the vehicle time; nothing where there is no screen."""
    console = console or Console(stderr=True)
    with Progress(*_columns(), console=console, transient=True, disable=_plain(console)) as bars:
        task = bars.add_task(f"t {_seconds(start_ns)} s", total=end_ns - start_ns)

        def told(t_ns: int) -> None:
            bars.update(task, completed=t_ns - start_ns, description=f"t {_seconds(t_ns)} s")

        yield told


@contextmanager
def progress_bar(what: str, console: Console | None = None) -> Iterator[Callable[[float], None]]:
    """A bar on stderr with the time left, told which share is done; nothing where there is no screen."""
    console = console or Console(stderr=True)
    with Progress(*_columns(), console=console, transient=True, disable=_plain(console)) as bars:
        task = bars.add_task(escape(what), total=1.0)
        yield lambda share: bars.update(task, completed=share)


@contextmanager
def reading_progress(what: object) -> Iterator[None]:
    """A bar on stderr with the time left while recordings are read, one after the other."""
    from services.recording.records import report_progress

    with progress_bar(str(what)) as told, report_progress(told):
        yield


def _columns() -> tuple[ProgressColumn, ...]:
    """Of a bar with the time left."""
    return TextColumn("{task.description}"), BarColumn(40), TaskProgressColumn(), TimeRemainingColumn()


def line(view: LiveView, errors: TrackingError) -> str:
    """The moment in one line."""
    words = [f"t {_seconds(view.t_ns)} s of {_seconds(view.end_ns)}", view.phase]
    if view.truth is not None:
        words.append(f"depth {view.truth.position_m[2]:.1f} m")
    if errors.true_error_m is not None:
        words.append(f"from the line {errors.true_error_m:.3f} m")
    if errors.localisation_m is not None:
        words.append(f"localisation {errors.localisation_m:.3f} m")
    if view.applied is not None:
        words.append("thrust " + " ".join(f"{x:.0f}" for x in view.applied.thrust_N) + " N")
    if view.timing is not None:
        words.append(f"cycle {view.timing.compute_wall_ns / 1e6:.1f} ms")
    words.append(f"late {view.applied.plans_late if view.applied else 0}")
    words.append(f"dropped {sum(s.dropped for s in view.status.values())}")
    words.append(f"rejected {sum(s.rejected for s in view.status.values())}")
    waiting = [f"{name} waits for {s.waiting_for}" for name, s in view.status.items() if s.waiting_for]
    return "  ".join([*words, *waiting])


def bar(thrust_N: float, min_N: float, max_N: float, width: int = BAR) -> str:
    """``|      ===+---          |``: from the middle to the thrust, left astern, right ahead."""
    half = width // 2
    bound = max_N if thrust_N > 0 else -min_N
    filled = min(half, round(half * abs(thrust_N) / bound)) if bound > 0 else 0
    left = "=" * filled if thrust_N < 0 else ""
    right = "=" * filled if thrust_N > 0 else ""
    return f"|{left:>{half}}+{right:<{half}}|"


def times(speed: float, asked: float) -> str:
    """``10x``, or ``3.1 of 10x`` on a machine that cannot do more."""
    return f"{asked:g}x" if speed == asked else f"{speed:.3g} of {asked:g}x"


def _progress(view: LiveView) -> Text:
    share = (view.t_ns - view.start_ns) / max(1, view.end_ns - view.start_ns)
    done = round(30 * min(max(share, 0.0), 1.0))
    return Text(
        f"t {_seconds(view.t_ns):>8} s of {_seconds(view.end_ns)}  [{'#' * done:<30}]"
        f"  {times(view.speed, view.requested_speed)}  {view.phase}  {view.wall_s:.0f} s",
        no_wrap=True,
    )


def _motion(view: LiveView, errors: TrackingError) -> list[Text]:
    truth = view.truth
    if truth is None:
        return [Text("depth      -"), Text("error      -")]
    heading_deg = math.degrees(truth.attitude_rad[2]) % 360
    return [
        Text(
            f"depth   {truth.position_m[2]:8.2f} m   heading {heading_deg:5.0f} deg"
            f"   current {math.hypot(*truth.current_mps):5.3f} m/s"
        ),
        Text(
            f"error   {_metres(errors.true_error_m)} from the line"
            f"   {_metres(errors.localisation_m)} localisation, since the start"
        ),
    ]


def _thrusts(view: LiveView, limits: Limits) -> list[Text]:
    lines = []
    for i, name in enumerate(("port", "starboard", "vertical")):
        least, most = limits[i]
        thrust = 0.0 if view.applied is None else view.applied.thrust_N[i]
        full = view.applied is not None and (thrust >= 0.999 * most or thrust <= 0.999 * least)
        lines.append(Text(f"{name:<10}{thrust:8.1f} N  {bar(thrust, least, most)}", style="yellow" if full else ""))
    return lines


def _ages(view: LiveView) -> list[Text]:
    estimate = "-" if view.estimate is None else f"{_seconds(view.t_ns - view.estimate.t_ns, 2)} s"
    plan = "-" if view.plan is None else f"{_seconds(view.t_ns - view.plan.cycle_t_ns, 2)} s ({view.plan.origin})"
    lines = [f"age     estimate {estimate}   plan {plan}   late {view.applied.plans_late if view.applied else 0}"]
    if view.timing is None:
        lines.append("cycle   -")
    else:
        longest = sorted(view.timing.stage_us.items(), key=lambda stage: -stage[1])[:4]
        stages = "  ".join(f"{name} {us / 1000:.2f}" for name, us in longest)
        lines.append(f"cycle   {view.timing.compute_wall_ns / 1e6:.1f} ms, most of it {stages}")
    return [Text(text, no_wrap=True, overflow="ellipsis") for text in lines]


def _processes(view: LiveView) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim", width=79)
    table.add_column("process")
    table.add_column("state", no_wrap=True, overflow="ellipsis", ratio=1)
    for name in ("steps", "sent", "heard", "dropped", "rejected", "us/step"):
        table.add_column(name, justify="right")
    names = [*(n for n in ORDER if n in view.state or n in view.status)]
    names += sorted((view.state.keys() | view.status.keys()) - set(names))
    for name in names:
        status, state = view.status.get(name), view.state.get(name, "")
        if status is None:
            table.add_row(name, state, *[""] * 6)
            continue
        if status.waiting_for:
            state = f"waits for {status.waiting_for}"
        counts = (status.steps, status.published, status.received, status.dropped, status.rejected)
        bad = "yellow" if status.dropped or status.rejected else ""
        table.add_row(name, state, *(str(x) for x in counts), f"{status.step_us:.0f}", style=bad)
    return table


def _seconds(t_ns: int, digits: int = 1) -> str:
    return f"{t_ns / 1e9:.{digits}f}"


def _metres(distance: float | None) -> str:
    return "       - m" if distance is None else f"{distance:8.3f} m"
