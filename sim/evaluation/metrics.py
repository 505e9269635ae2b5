"""Grades a run from its own messages, in lock step as they are published, or from a recording. Pure.

With p(t) the truth, e(t) the estimate and r(t) the reference (of a path where its target is), horizontal, t = 0 the
start of the descent:

    tracking      e(t) - r(t)
    localisation  (e(t) - e(0)) - (p(t) - p(0))
    true          (p(t) - p(0)) - (r(t) - e(0)) = tracking - localisation

sampled at the estimates' times t > 0: drift since t = 0, so that the error of the fix at the surface is in none of
them (it is in ``localisation_error_absolute_m``).

Between two reports of the actuators the command is taken as linear, which it is but for a knot in between.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ltv_mpc.messages import Applied, Array, Clock, ClockState, CycleTiming, Estimate, Message, Pair, Plan, Truth
from ltv_mpc.vehicle.parameters import Vehicle
from sim.evaluation.summary import Quantiles, Spread, Thrust

AT_BOX_N = 1e-6
"""A command this close to its minimum or maximum is saturated."""


class _Planned(NamedTuple):
    start_ns: int
    estimate_t_ns: int
    published_ns: int


class _Taken(NamedTuple):
    """A plan that the plant took: times along its way (vehicle ns), and the speed of the clock then."""

    plan: _Planned
    received_ns: int
    speed: float

    @property
    def effect_ns(self) -> int:
        return max(self.plan.start_ns, self.received_ns)


class _Target(NamedTuple):
    """Where a plan steered to."""

    since_ns: int  # start of its cycle
    t_ns: int  # when the target is there: the plan's first knot
    place: Pair
    moves: bool  # along a path


class RunMetrics:
    """Fed with every message of a run, in order of publication; then asked."""

    def __init__(self, vehicle: Vehicle, *, speed: float = 1.0) -> None:
        """``speed``: of the clock, until a ``Clock`` says otherwise."""
        self.cycles = 0
        self.deadline_misses = 0
        self.plans_refused = 0
        self.qp_status: Counter[str] = Counter()
        self.plan_origin: Counter[str] = Counter()
        self._box = np.array([[t.min_N, t.max_N] for t in vehicle.thrusters[:2]])  # (2, 2): thruster, bound
        self._speed = speed
        self._first_clock: Clock | None = None
        self._newest_clock: Clock | None = None
        self._truth: list[tuple[int, float, float]] = []
        self._estimate: list[tuple[int, float, float]] = []
        self._reference: list[_Target] = []
        self._command: list[tuple[int, float, float, float]] = []  # t, port, starboard, slew
        self._waiting: dict[tuple[int, int], _Planned] = {}  # by epoch and sequence: not yet taken
        self._taken: list[_Taken] = []
        self._timing: list[tuple[CycleTiming, float]] = []
        self._hear: dict[type[Message], Callable[[Any, int, int, int], None]] = {
            Truth: self._hear_truth,
            Estimate: self._hear_estimate,
            Plan: self._hear_plan,
            Applied: self._hear_applied,
            CycleTiming: self._hear_timing,
            Clock: self._hear_clock,
        }

    @property
    def hears(self) -> frozenset[type[Message]]:
        """Of which types it takes note."""
        return frozenset(self._hear)

    @property
    def until_ns(self) -> int:
        """How far the run has come: vehicle time of the last truth."""
        return self._truth[-1][0] if self._truth else 0

    def observe(self, signal: Message, *, epoch: int, sequence: int, t_ns: int) -> None:
        """A message: its source's epoch, its number of its key, and when it was published (vehicle time)."""
        hear = self._hear.get(type(signal))
        if hear is not None:
            hear(signal, epoch, sequence, t_ns)

    def errors(self) -> tuple[Spread, Spread, Spread, Spread]:
        """Tracking, true, localisation and absolute localisation error."""
        at = np.array([t for t, _, _ in self._estimate if t > 0], dtype=np.int64)
        if not len(at) or not self._truth:
            nothing = _spread(np.empty(0))
            return nothing, nothing, nothing, nothing
        estimate, truth = _track(self._estimate, at), _track(self._truth, at)  # (K, 2) each
        zero = np.zeros(1, dtype=np.int64)
        estimate_0, truth_0 = _track(self._estimate, zero), _track(self._truth, zero)
        reference = self._references(at, estimate_0)
        localisation = (estimate - estimate_0) - (truth - truth_0)
        tracking = estimate - reference
        true = (truth - truth_0) - (reference - estimate_0)
        return tuple(_spread(np.hypot(*e.T)) for e in (tracking, true, localisation, estimate - truth))  # type: ignore[return-value]

    def thrust(self) -> Thrust:
        """Of the commands in force from t = 0 on."""
        rows = np.array([row for row in self._command if row[0] >= 0]).reshape(-1, 4)
        if len(rows) < 2:
            return Thrust(
                saturated_fraction=None, max_abs_N=None, mean_abs_N=None, travel_N=None, max_slew_N_per_s=None
            )
        h, F = np.diff(rows[:, 0]), rows[:, 1:3]  # (K-1,), (K, 2)
        low, high = self._box.T
        a, b = F[:-1], F[1:]
        at_box = ((a <= low + AT_BOX_N) & (b <= low + AT_BOX_N)) | ((a >= high - AT_BOX_N) & (b >= high - AT_BOX_N))
        return Thrust(
            saturated_fraction=float(np.average(at_box.any(axis=1), weights=h)),
            max_abs_N=float(np.max(np.abs(F))),
            mean_abs_N=float(np.average(_mean_abs(a, b).mean(axis=1), weights=h)),
            travel_N=float(np.sum(np.abs(b - a))),
            max_slew_N_per_s=float(np.max(rows[1:, 3])),
        )

    def speed_reached(self) -> float | None:
        """Vehicle seconds per second of the wall, from the clock's start to its last change, pauses included."""
        first, newest = self._first_clock, self._newest_clock
        if first is None or newest is None or newest.at_monotonic_us <= first.at_monotonic_us:
            return None
        return (newest.vehicle_ns - first.vehicle_ns) / 1e3 / (newest.at_monotonic_us - first.at_monotonic_us)

    def compute_delay(self, *, wall: bool = False) -> Quantiles:
        """From the start of a cycle to its plan's publication (s)."""
        return quantiles([(t.compute_wall_ns if wall else t.compute_ns) / 1e9 for t, _ in self._timing])

    def end_to_end_delay(self, *, wall: bool = False) -> Quantiles:
        """From an estimate's validity time to the instant at which the plan made of it takes effect (s)."""
        return quantiles([(x.effect_ns - x.plan.estimate_t_ns) / 1e9 / (x.speed if wall else 1.0) for x in self._taken])

    def stages(self) -> dict[str, Quantiles]:
        """Wall time of each stage of a cycle (us), from the age of the estimate to the plan's taking effect."""
        laps: dict[str, list[float]] = {"age": []}
        for timing, speed in self._timing:
            laps["age"].append(timing.estimate_age_ns / 1e3 / speed)
            for stage, us in timing.stage_us.items():
                laps.setdefault(stage, []).append(us)
        laps["transport"] = [(x.received_ns - x.plan.published_ns) / 1e3 / x.speed for x in self._taken]
        laps["apply"] = [(x.effect_ns - x.received_ns) / 1e3 / x.speed for x in self._taken]
        return {stage: quantiles(us) for stage, us in laps.items() if us}

    def _references(self, at: np.ndarray[Any, Any], start: Array) -> Array:
        """(K, 2): that of the newest plan at each time; before the first that has one, the first.

        Of a path it moves evenly from the one plan's first knot to the next one's.
        """
        if not self._reference:
            return np.broadcast_to(start, (len(at), 2))
        since = np.array([target.since_ns for target in self._reference])
        newest = np.maximum(np.searchsorted(since, at, side="right") - 1, 0)
        stands: Array = np.array([target.place for target in self._reference])[newest]
        moves = np.array([target.moves for target in self._reference])[newest]
        if moves.any():
            way = [target for target in self._reference if target.moves]
            stands[moves] = _track([(target.t_ns, *target.place) for target in way], at[moves])
        return stands

    def _hear_truth(self, truth: Truth, *_: int) -> None:
        self._truth.append((truth.t_ns, truth.position_m[0], truth.position_m[1]))

    def _hear_estimate(self, estimate: Estimate, *_: int) -> None:
        self._estimate.append((estimate.t_ns, estimate.north_m, estimate.east_m))

    def _hear_plan(self, plan: Plan, epoch: int, sequence: int, t_ns: int) -> None:
        self.cycles += 1
        self.qp_status[plan.solve.status.value] += 1
        self.plan_origin[plan.origin.value] += 1
        self._waiting[epoch, sequence] = _Planned(int(plan.t_ns[0]), plan.estimate_t_ns, t_ns)
        if plan.reference_m is not None:
            moves = plan.progress is not None
            self._reference.append(_Target(plan.cycle_t_ns, int(plan.t_ns[0]), plan.reference_m, moves))

    def _hear_applied(self, applied: Applied, *_: int) -> None:
        port, starboard, _vertical = applied.command_N
        self._command.append((applied.t_ns, port, starboard, max(applied.command_slew_N_per_s[:2])))
        self.deadline_misses, self.plans_refused = applied.plans_late, applied.plans_rejected
        plan = self._waiting.pop((applied.plan_epoch, applied.plan_sequence), None)
        if plan is not None:
            self._taken.append(_Taken(plan, applied.plan_received_t_ns, self._speed))

    def _hear_timing(self, timing: CycleTiming, *_: int) -> None:
        self._timing.append((timing, self._speed))

    def _hear_clock(self, clock: Clock, *_: int) -> None:
        self._speed = clock.speed_num / clock.speed_den
        if self._first_clock is None and clock.state is ClockState.RUNNING:
            self._first_clock = clock
        self._newest_clock = clock


def quantiles(values: list[float]) -> Quantiles:
    """Median, 99 % quantile and maximum; nulls of nothing."""
    if not values:
        return Quantiles(median=None, p99=None, max=None)
    median, p99, top = np.quantile(values, (0.5, 0.99, 1.0))
    return Quantiles(median=float(median), p99=float(p99), max=float(top))


def _spread(error: Array) -> Spread:
    if not len(error):
        return Spread(mean=None, max=None, final=None)
    return Spread(mean=float(error.mean()), max=float(error.max()), final=float(error[-1]))


def _mean_abs(a: Array, b: Array) -> Array:
    """Mean of |F| over a segment on which F goes from a to b linearly; (a^2 + b^2) / 2 (|a| + |b|) if it crosses 0."""
    total = np.abs(a) + np.abs(b)
    crossing = np.divide(a * a + b * b, 2.0 * total, out=np.zeros_like(a), where=total > 0)
    return np.where(a * b < 0, crossing, 0.5 * total)


def _track(rows: list[tuple[int, float, float]], at: np.ndarray[Any, Any]) -> Array:
    """(K, 2) north, east at the times ``at``, linear between rows, constant beyond both ends."""
    t, north, east = np.array(rows).T
    return np.column_stack([np.interp(at, t, north), np.interp(at, t, east)])
