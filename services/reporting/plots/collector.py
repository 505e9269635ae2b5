"""Collector of plot tables from the messages of a recording or of a running bus.

Memory is bounded for runs of any length. The tables of ``HISTORY`` grow and are decimated; those of
``Collector.current_tables`` hold the newest state only: horizon of the newest plan, error ellipse, current profile.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ltv_mpc.messages import Applied, Array, Clock, CurrentProfile, CycleTiming, Estimate, Message, Plan, Truth
from ltv_mpc.vehicle.parameters import Thruster
from services.reporting.plots.events import Marks
from services.reporting.plots.table import Columns, Table, short
from services.reporting.plots.truth import TrueTrack, principal

MAX_PLAIN_NS = 1_000_000_000_000_000
"""Largest vehicle time that is plotted as it is: 11 days. Times since 1970 are plotted from the first message on."""

ROWS = 1_500
"""Row limit of a table; about the width of a screen in pixels."""

HISTORY = {
    "track": ("t_s", "north_m", "east_m", "depth_m"),
    "truth": ("t_s", "north_m", "east_m", "depth_m"),
    "reference": ("t_s", "north_m", "east_m", "depth_m"),
    "errors": ("t_s", "north_m", "east_m", "minus_2_sigma_m", "plus_2_sigma_m"),
    "distance": ("t_s", "distance_m"),
    "true_distance": ("t_s", "distance_m"),
    "thrust": ("t_s", "port_N", "starboard_N"),
    "true_current": ("depth_m", "north_mps", "east_mps"),
    "latency": (
        *("t_s", "cycle_ms", "predict_ms", "linearise_ms", "build_ms", "solve_ms", "publish_ms", "deadline_ms"),
        "estimate_age_ms",
    ),
    "delivery": ("t_s", "plan_ms"),
}
PEAKS = {"latency": "cycle_ms", "delivery": "plan_ms"}

STAGES = (("read", "predict"), ("linearise",), ("build", "update"), ("solve",), ("publish",))
"""Stages of a cycle; those of one tuple are plotted as their sum."""

ESTIMATES_NS = 100_000_000
ELLIPSE = 48  # points
SIGMAS = 2.0


class Collector:
    """Builder of plot tables; takes messages in the order of their publication.

    ``thrusters`` are port and starboard, whose limits are plotted; None if they are unknown. ``origin_ns`` is the
    vehicle time at which plotted times are zero; None: the time of the first message, if it is large as a time since
    1970 is, otherwise 0.
    """

    def __init__(
        self,
        thrusters: tuple[Thruster, Thruster] | None = None,
        *,
        rows: int = ROWS,
        origin_ns: int | None = None,
    ) -> None:
        self._origin_ns = origin_ns
        self.tables = {name: Table(columns, limit=rows, peak=PEAKS.get(name, "")) for name, columns in HISTORY.items()}
        self.marks = Marks(self.seconds)
        self.values: dict[str, float] = {}
        self.set_limits(thrusters)
        self._true = TrueTrack()
        self._speed = 1.0
        self._estimate: Estimate | None = None
        self._plan: Plan | None = None
        self.profile: CurrentProfile | None = None
        """Estimated current, from the newest estimate that has one."""
        self._targets: list[tuple[int, float, float]] = []  # t_ns, north, east of the last two plans
        self._waiting: list[tuple[Table, int, float, float]] = []  # positions that wait for the next target
        self._handlers: dict[type[Message], Callable[[Any], None]] = {
            Truth: self._add_truth,
            Estimate: self._add_estimate,
            Plan: self._add_plan,
            Applied: self._add_applied,
            CycleTiming: self._add_timing,
            Clock: self._add_clock,
        }

    @property
    def estimate(self) -> Estimate | None:
        """Newest estimate."""
        return self._estimate

    @property
    def plan(self) -> Plan | None:
        """Newest plan."""
        return self._plan

    def set_limits(self, thrusters: tuple[Thruster, Thruster] | None) -> None:
        """Set the thrust limits that are plotted, of port and starboard; None: no change."""
        for side, thruster in zip(("port", "starboard"), thrusters or (), strict=False):
            self.values |= {f"{side}_min_N": thruster.min_N, f"{side}_max_N": thruster.max_N}

    def seconds(self, t_ns: int) -> float:
        """Return a vehicle time as it is plotted (s)."""
        if self._origin_ns is None:
            self._origin_ns = t_ns if abs(t_ns) > MAX_PLAIN_NS else 0
        return (t_ns - self._origin_ns) / 1e9

    def add(self, signal: Message, epoch: int) -> None:
        """Add a message; ``epoch`` is the one of its sender."""
        handler = self._handlers.get(type(signal))
        if handler is not None:
            handler(signal)
        self.marks.add(signal, epoch)

    def current_tables(self) -> dict[str, Columns]:
        """Return the tables of the newest state."""
        return {
            **_of_plan(self._plan, self.seconds),
            "ellipse": self._ellipse(),
            "profile": _profile(self.profile),
        }

    def all_tables(self) -> dict[str, Columns]:
        """Return every table with all rows."""
        return {**{name: table.since(0) for name, table in self.tables.items()}, **self.current_tables()}

    # --- one message type each ---------------------------------------------------------------------------------------

    def _add_truth(self, truth: Truth) -> None:
        if self._true.add(truth):
            self._show_truth(truth)

    def _show_truth(self, truth: Truth) -> None:
        position = self._true.position(truth)
        if position is None:
            return
        self.tables["truth"].add(self.seconds(truth.t_ns), *position, truth.position_m[2])
        self.tables["true_current"].add(truth.position_m[2], *truth.current_mps)
        self._wait_for_target("true_distance", truth.t_ns, *position)

    def _add_estimate(self, estimate: Estimate) -> None:
        last = self._estimate
        if last is not None and 0 <= estimate.t_ns - last.t_ns < ESTIMATES_NS:
            return
        self._estimate = estimate
        self.profile = estimate.current or self.profile
        for truth in self._true.begin(estimate):
            self._show_truth(truth)
        self.tables["track"].add(self.seconds(estimate.t_ns), estimate.north_m, estimate.east_m, estimate.depth_m)
        self._wait_for_target("distance", estimate.t_ns, estimate.north_m, estimate.east_m)
        error = self._true.error(estimate)
        if error is None and self._true.known:
            return
        covariance = self._true.covariance(estimate)
        spread = None if covariance is None else SIGMAS * float(principal(covariance)[0][-1])
        self.tables["errors"].add(
            self.seconds(estimate.t_ns), *(error or (None, None)), None if spread is None else -spread, spread
        )

    def _add_plan(self, plan: Plan) -> None:
        self._plan = plan
        if plan.reference_m is None:
            return
        t_ns = int(plan.t_ns[0])
        if not self._targets:  # there was no reference before
            self._waiting = [one for one in self._waiting if one[1] >= plan.cycle_t_ns]
        self.tables["reference"].add(self.seconds(t_ns), *plan.reference_m, plan.reference_depth_m)
        last = self._targets[-1] if self._targets and plan.progress is not None else (t_ns, *plan.reference_m)
        self._targets = [last, (t_ns, *plan.reference_m)]
        waiting, self._waiting = self._waiting, []
        for table, then_ns, north, east in waiting:
            if then_ns > t_ns and plan.progress is not None:
                self._waiting.append((table, then_ns, north, east))
            else:
                table.add(self.seconds(then_ns), math.hypot(*self._from_target(then_ns, north, east)))

    def _add_applied(self, applied: Applied) -> None:
        self.tables["thrust"].add(self.seconds(applied.t_ns), *applied.thrust_N[:2])
        delay_ms = (applied.plan_received_t_ns - applied.plan_cycle_t_ns) / 1e6
        if len(self.tables["latency"]) and applied.plan_sequence >= 0 and delay_ms > 0.0:
            self.tables["delivery"].add(self.seconds(applied.t_ns), delay_ms)

    def _add_timing(self, timing: CycleTiming) -> None:
        cycle_ms = (timing.compute_wall_ns or timing.compute_ns) / 1e6
        if not cycle_ms:  # lock-step runs measure no time
            return
        plan = self._plan
        deadline_ms = None
        if plan is not None and plan.cycle_t_ns == timing.t_ns:
            deadline_ms = (int(plan.t_ns[0]) - plan.cycle_t_ns) / 1e6 / self._speed
        us = [sum(timing.stage_us.get(name, 0.0) for name in names) for names in STAGES]
        # a logarithmic axis cannot show zero
        self.tables["latency"].add(
            self.seconds(timing.t_ns),
            cycle_ms,
            *((one / 1e3) or None for one in us),
            deadline_ms or None,
            max(timing.estimate_age_ns / 1e6, 0.0) or None,
        )

    def _add_clock(self, clock: Clock) -> None:
        self._speed = clock.speed_num / clock.speed_den

    # --- the reference -----------------------------------------------------------------------------------------------

    def _wait_for_target(self, table: str, t_ns: int, north_m: float, east_m: float) -> None:
        """Queue a position until a plan with a later target gives the reference at that time."""
        self._waiting.append((self.tables[table], t_ns, north_m, east_m))
        del self._waiting[:-1000]  # bounds the memory if no plans arrive

    def _from_target(self, t_ns: int, north_m: float, east_m: float) -> tuple[float, float]:
        """Return the offset (m) from the reference, interpolated linearly between the targets of two plans."""
        (t0, north0, east0), (t1, north1, east1) = self._targets
        s = min(max((t_ns - t0) / (t1 - t0), 0.0), 1.0) if t1 > t0 else 1.0
        return north_m - north0 - s * (north1 - north0), east_m - east0 - s * (east1 - east0)

    def _ellipse(self) -> Columns:
        """Return the 2-sigma ellipse of the estimated position."""
        estimate = self._estimate
        covariance = None if estimate is None else self._true.covariance(estimate)
        if estimate is None or covariance is None:
            return {"north_m": [], "east_m": []}
        sigma, axes = principal(covariance)
        angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE + 1)
        outline: Array = SIGMAS * axes @ (sigma[:, None] * np.array([np.cos(angle), np.sin(angle)]))  # (2, ELLIPSE+1)
        return {
            "north_m": [short(x + estimate.north_m) for x in outline[0]],
            "east_m": [short(x + estimate.east_m) for x in outline[1]],
        }


def _of_plan(plan: Plan | None, seconds: Callable[[int], float]) -> dict[str, Columns]:
    if plan is None:
        nothing: Columns = {}
        return {"horizon": nothing, "ahead": nothing, "target": nothing}
    horizon: Columns = {
        "north_m": [short(x) for x in plan.states[:, 0]],
        "east_m": [short(x) for x in plan.states[:, 1]],
    }
    ahead: Columns = {
        "t_s": [short(seconds(t)) for t in plan.t_ns.tolist()],
        "port_N": [short(x) for x in plan.thrust_N[:, 0]],
        "starboard_N": [short(x) for x in plan.thrust_N[:, 1]],
    }
    target: Columns = {}
    if plan.reference_m is not None:
        target = {"north_m": [short(plan.reference_m[0])], "east_m": [short(plan.reference_m[1])]}
    return {"horizon": horizon, "ahead": ahead, "target": target}


def _profile(profile: CurrentProfile | None) -> Columns:
    """Return the table of a current profile with its 2-sigma band, one row for each depth."""
    if profile is None:
        return {}
    columns: Columns = {"depth_m": [short(x) for x in profile.depth_m]}
    for name, velocity in (("north", profile.north_mps), ("east", profile.east_mps)):
        columns[f"{name}_mps"] = [short(x) for x in velocity]
        if profile.sd_mps is not None:
            columns[f"{name}_low_mps"] = [short(x) for x in velocity - SIGMAS * profile.sd_mps]
            columns[f"{name}_high_mps"] = [short(x) for x in velocity + SIGMAS * profile.sd_mps]
    return columns
