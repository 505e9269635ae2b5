"""Terminal output of a run: a live screen of 80 x 24 characters, or a plain line every few seconds without one."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, Progress, ProgressColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from ltv_mpc.errors import one_line
from ltv_mpc.messages import ControllerStatus, SensorStatus
from ltv_mpc.vehicle.parameters import Vehicle
from services.reporting.plots.collector import Collector
from services.reporting.plots.vehicle_from_above import current_at
from services.runtime.console import WIDTH, drawn, figure, fold
from services.supervisor.screen import LiveView, in_order

REDRAW_S = 0.125
LINE_S = 5.0
PROGRESS = 12  # width of the bar of the time, in characters
BAR = 31  # width in characters, from full astern to full ahead
THRUSTERS = ("port", "starboard", "vertical")
AT_LIMIT = rf".*\|(?:={{{BAR // 2}}}\+ *| *\+={{{BAR // 2}}})\|$"
"""Line of a thruster whose bar is full."""


def is_plain(console: Console) -> bool:
    """Return True if nothing may be redrawn in place: stderr is a pipe, or NO_COLOR or CI is set."""
    return "NO_COLOR" in os.environ or "CI" in os.environ or not console.is_terminal


def stderr_console() -> Console:
    """Return a console that draws on the stream behind standard error, which escapes control characters."""
    return Console(file=drawn(sys.stderr))


class RunScreen:
    """Screen of a run: redrawn in place on a terminal, otherwise a line every ``LINE_S``."""

    def __init__(
        self,
        title: str,
        vehicle: Vehicle | None,
        console: Console | None = None,
        files: Mapping[str, str] | None = None,
    ) -> None:
        """``vehicle`` has the limits of the thrusts; ``files`` are the settings of the run."""
        self._title = title
        self._console = console or stderr_console()
        self._collector = Collector(vehicle)
        self._collector.set_files(files or {})
        self._live: Live | None = None
        if not is_plain(self._console):
            self._live = Live(console=self._console, auto_refresh=False, vertical_overflow="crop")
            self._live.start()
        self._next = 0.0
        self._waiting = Progress(*_columns(), console=self._console)

    def update(self, view: LiveView) -> None:
        """Show the state of the run, unless the last one is too recent."""
        observe(self._collector, view)
        if self._is_due():
            if self._live is None:
                self.say(line(view, self._collector))
            else:
                self._live.update(self.render(view), refresh=True)

    def wait(self, what: str, share: float) -> None:
        """Show the progress of a preparation, on a terminal as a bar with the time left in place of the screen."""
        if not self._is_due():
            return
        if self._live is None:
            self.say(f"{what}: {share:.0%}")
            return
        if not self._waiting.task_ids:
            self._waiting.add_task("", total=1.0)
        self._waiting.update(self._waiting.task_ids[0], completed=share, description=escape(one_line(what)))
        self._live.update(self._waiting.get_renderable(), refresh=True)

    def say(self, text: str) -> None:
        """Print a line, on a terminal above the screen."""
        shown = one_line(text)
        self._console.print(Text(shown if self._live is None else fold(shown, self._console.width)), soft_wrap=True)

    def close(self) -> None:
        """Stop redrawing and leave the last screen visible."""
        if self._live is not None:
            self._live.stop()

    def render(self, view: LiveView) -> Group:
        """Return the complete screen."""
        lines = [
            *(self._title, _progress(view), ""),
            *(*_motion(view, self._collector), *_localisation(view), ""),
            *(*_thrusts(view, self._collector.vehicle), "", *_ages(view), ""),
        ]
        texts = [Text(one_line(text), no_wrap=True, overflow="ellipsis") for text in lines]
        texts[0].stylize("bold")
        for text in texts:
            text.highlight_regex(AT_LIMIT, "yellow")
        return Group(*texts, _processes(view))

    def _is_due(self) -> bool:
        if (now := time.monotonic()) < self._next:
            return False
        self._next = now + (LINE_S if self._live is None else REDRAW_S)
        return True


@contextmanager
def progress_bar(
    what: str, console: Console | None = None, *, line_s: float = math.inf
) -> Iterator[Callable[..., None]]:
    """Show a bar with the time left on stderr if it is a terminal, otherwise a line every ``line_s``.

    Call the result with the share done, 0 .. 1, and a new text if there is one.
    """
    console = console or stderr_console()
    plain, due = is_plain(console), time.monotonic() + line_s
    with Progress(*_columns(), console=console, transient=True, disable=plain) as bars:
        task = bars.add_task(escape(one_line(what)), total=1.0)

        def show(share: float, text: str = what) -> None:
            nonlocal due
            bars.update(task, completed=share, description=escape(one_line(text)))
            if plain and time.monotonic() >= due:
                due = time.monotonic() + line_s
                console.out(f"{one_line(text)}: {share:.0%}", highlight=False)

        yield show


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
    """Format the state of the run in one line: what the screen says without bars, and the sum of what was lost."""
    end = "" if view.end_ns is None else f" of {_seconds(view.end_ns)}"
    words = [f"t {_seconds(view.t_ns)} s{end}", view.phase, *_motion(view, collector), *_localisation(view)]
    if view.applied is not None:
        words.append(f"thrust {' '.join(f'{x:z.0f}' for x in view.applied.thrust_N)} N  late {view.applied.plans_late}")
    if view.timing is not None:
        words.append(f"cycle {view.timing.compute_wall_ns / 1e6:.1f} ms")
    words += [f"{name} {sum(getattr(s, name) for s in view.status.values())}" for name in ("dropped", "rejected")]
    words += [f"{name} waits for {s.waiting_for}" for name, s in view.status.items() if s.waiting_for]
    return "  ".join(" ".join(part.split()) for part in words)


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


def _progress(view: LiveView) -> str:
    if view.end_ns is None:
        t = "-" if view.estimate is None and not view.status else f"{_seconds(view.t_ns)} s"
        return f"t {t:>10}  {view.phase}"
    share = (view.t_ns - view.start_ns) / max(1, view.end_ns - view.start_ns)
    done = "#" * round(PROGRESS * min(max(share, 0.0), 1.0))
    t = f"t {_seconds(view.t_ns):>8} s of {_seconds(view.end_ns)}  [{done:<{PROGRESS}}]"
    return f"{t}  {times(view.speed, view.requested_speed)}  {view.phase}  wall time {view.wall_s:.0f} s"


def _motion(view: LiveView, collector: Collector) -> list[str]:
    """Return where the vehicle is by its estimate, how far from the reference, and who controls it in which health."""
    estimate, controller, since_s = view.estimate, view.controller, collector.marks.since_s.get("health")
    lasts = "" if since_s is None else f", {max(collector.seconds(view.t_ns) - since_s, 0.0):.0f} s"
    if estimate is None:
        return ["motion  no estimate yet", "error   -", *_control(controller, lasts)]
    depth = "" if estimate.depth_m is None else f"depth {round(estimate.depth_m, 2) + 0.0:.2f} m   "
    speed_mps = math.hypot(estimate.velocity_north_mps, estimate.velocity_east_mps)
    words = f"{depth}heading {round(math.degrees(estimate.heading_rad)) % 360} deg   speed {speed_mps:.3f} m/s"
    if (current := estimate.current) is not None:
        current_mps = math.hypot(*current_at(current, estimate.depth_m or 0.0))
        words += f"   current {current_mps:.3f} m/s"
    error = f"estimate from the reference {figure(collector.error_m, 'm', digits='.3f', none='- m')}"
    if view.truth is not None:
        vehicle = f"vehicle {'' if collector.since else 'from the reference '}"  # 80 columns
        error += (
            f"   {vehicle}{figure(collector.true_error_m, 'm', digits='.3f', none='- m')} {collector.since}".rstrip()
        )
    return [f"motion  {words}", f"error   {error}", *_control(controller, lasts)]


def _control(controller: ControllerStatus | None, lasts: str) -> list[str]:
    if controller is None:
        return ["control no status of a controller yet"]
    way = "" if controller.progress is None else f"   progress {100 * controller.progress:.0f} %"
    state = f"control {controller.authority}   {controller.health}{'   arrived' if controller.arrived else way}"
    return [state, f"why     {controller.health_why}{lasts}"] if controller.health_why else [state]


def _localisation(view: LiveView) -> list[str]:
    """Return the line of the localisation filter: its status with the reason, and the sensors that are not ok.

    A vehicle with a navigation of its own has none.
    """
    if (report := view.localisation) is None:
        return [] if view.end_ns is None else ["filter  -"]
    why = f" ({report.why})" if report.why else ""
    wrong = [f"{one.sensor} {one.status}" for one in report.sensors if one.status is not SensorStatus.OK]
    return ["   ".join([f"filter  {report.status}{why}", *wrong])]


def _thrusts(view: LiveView, vehicle: Vehicle | None) -> list[str]:
    """Return a line for each thruster: its force, and a bar if its limits are known. A surface craft has two."""
    dives = vehicle.can_dive if vehicle else view.estimate is None or view.estimate.depth_m is not None
    names = THRUSTERS if dives else THRUSTERS[:2]
    if view.applied is None:
        return [f"{name:<10}{'-':>8} N" for name in names]
    thrusts_N, thrusters = view.applied.thrust_N, vehicle.thrusters if vehicle else ()
    bars = [f"  {bar(thrust_N, one.min_N, one.max_N)}" for thrust_N, one in zip(thrusts_N, thrusters, strict=False)]
    bars = bars or [""] * len(names)
    return [f"{name:<10}{thrust_N:z8.1f} N{one}" for name, thrust_N, one in zip(names, thrusts_N, bars, strict=False)]


def _ages(view: LiveView) -> list[str]:
    estimate = "-" if view.estimate is None else f"{_seconds(view.t_ns - view.estimate.t_ns, 2)} s"
    plan = "-" if view.plan is None else f"{_seconds(view.t_ns - view.plan.cycle_t_ns, 2)} s ({view.plan.origin})"
    late = view.applied.plans_late if view.applied else 0
    cycle = "cycle   -"
    if view.timing is not None:
        cycle = f"cycle   {view.timing.compute_wall_ns / 1e6:.1f} ms, most of it:"
        for name, us in sorted(view.timing.stage_us.items(), key=lambda stage: -stage[1])[:4]:
            stage = f"  {name} {us / 1000:.2f}"
            cycle += stage if len(cycle) + len(stage) <= WIDTH else ""
    return [f"age     estimate {estimate}   plan {plan}   late plans {late}", cycle]


def _processes(view: LiveView) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim", width=79)
    table.add_column("process")
    table.add_column("state", no_wrap=True, overflow="ellipsis", ratio=1)
    for name in ("steps", "sent", "received", "dropped", "rejected", "us/step"):
        table.add_column(name, justify="right")
    states = {**dict.fromkeys(view.status, ""), **view.state}
    for name, state in in_order(states):
        cells = [name, state]
        if (status := view.status.get(name)) is not None:
            cells = [name, f"waits for {status.waiting_for}" if status.waiting_for else state]
            counts = (status.steps, status.published, status.received, status.dropped, status.rejected)
            cells += [*map(str, counts), f"{status.step_us:.0f}"]
        bad = status is not None and (status.dropped or status.rejected)
        table.add_row(*(Text(one_line(cell)) for cell in cells), style="yellow" if bad else "")
    return table


def observe(collector: Collector, view: LiveView) -> None:
    """Pass a view to the collector of the plots, for the distance that page and report show too."""
    for message in (view.truth, view.estimate, view.plan):
        if message is not None:
            collector.add(message, epoch=0)


def _seconds(t_ns: int, digits: int = 1) -> str:
    return f"{t_ns / 1e9:z.{digits}f}"
