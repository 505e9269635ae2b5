"""Metrics of one run, computed from its messages: in lock step as they are published, or from a recording.

With p(t) the truth, e(t) the estimate, r(t) the reference (on a path: its target), horizontal, and t = 0 the start of
the descent:

    tracking      e(t) - r(t)
    localisation  (e(t) - e(0)) - (p(t) - p(0)),   absolute  e(t) - p(t)
    true          p(t) - r(t)                      of a reference that is given in places
                  (p(t) - p(0)) - (r(t) - e(0))    of one that begins where the vehicle is, and the drift of both

sampled at the times t > 0 of the estimates. Drift since t = 0 does not contain the error of the surface fix, e(0) -
p(0). A line that begins at the estimate has this error itself, a place on a map has not.

Between two reports of the actuators the command is taken as linear in time. It is, except at a knot between them.
What a long run has many of is kept as plain numbers, rows one after the other: 20 MB for an hour.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ltv_mpc.errors import with_reason
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.messages import (
    Applied,
    Array,
    Clock,
    ClockState,
    CycleTiming,
    Estimate,
    FenceInForce,
    Message,
    Plan,
    Truth,
)
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.propulsion import propulsive_power_W, relative_power
from sim.evaluation.fence_distances import FenceDistances
from sim.evaluation.further import Positions
from sim.evaluation.summary import Quantiles, Spread, Thrust

ZERO = np.zeros(1)
"""Start of the descent (ns), (1,)."""

AT_BOX_N = 1e-6
"""Largest distance of a saturated command from its minimum or maximum (N)."""


class TrackErrors:
    """True, estimated and reference positions of a run, and the errors between them.

    ``in_places``: the reference is given in places, and does not begin where the vehicle is.
    """

    def __init__(self, *, in_places: bool) -> None:
        self._in_places = in_places
        self._truth = array("d")  # t, north, east
        self._estimate = array("d")
        self._reference = array("d")  # of each plan: start of its cycle, first knot, target there, 1 on a path
        self.arrived_s: float | None = None
        """Vehicle time of the first plan after an arrival (s)."""

    @property
    def until_ns(self) -> int:
        """Vehicle time of the last truth."""
        return int(self._truth[-3]) if self._truth else 0

    def add_truth(self, truth: Truth) -> None:
        """Add the true position."""
        self._truth.extend((truth.t_ns, *truth.position_m[:2]))

    def add_estimate(self, estimate: Estimate, *_: int) -> None:
        """Add the estimated position."""
        self._estimate.extend((estimate.t_ns, estimate.north_m, estimate.east_m))

    def add_plan(self, plan: Plan) -> None:
        """Add the reference point of a plan if it has one."""
        if plan.arrived and self.arrived_s is None:
            self.arrived_s = plan.cycle_t_ns * 1e-9
        if plan.reference_m is not None:
            self._reference.extend((plan.cycle_t_ns, plan.t_ns[0], *plan.reference_m, plan.progress is not None))

    @cached_property
    def positions(self) -> Positions | None:
        """Positions of the run, from t = 0 on; None without any."""
        estimate, truth = _rows(self._estimate, 3), _rows(self._truth, 3)
        at = estimate[estimate[:, 0] > 0.0, 0]
        if not len(at) or not len(truth):
            return None
        shift = 0.0 if self._in_places else self._fix()
        references = self._references(at, _track(estimate, ZERO))
        return Positions(at / 1e9, _track(estimate, at), _track(truth, at) + shift, references)

    def errors(self) -> dict[str, Spread]:
        """Return all errors by their names in ``Summary``."""
        nothing = np.empty((0, 2))
        at = self.positions or Positions(np.empty(0), nothing, nothing, nothing)
        fix = self._fix() if self.positions else nothing
        drifting = at.true_m + fix if self._in_places else at.true_m
        errors = {
            "tracking_error_m": at.estimate_m - at.reference_m,
            "true_error_m": at.true_m - at.reference_m,
            "true_error_drift_m": drifting - at.reference_m,
            "localisation_error_m": (localisation := at.estimate_m - drifting),
            "localisation_error_absolute_m": localisation + fix,
        }
        return {name: _spread(np.hypot(*error.T)) for name, error in errors.items()}

    def _fix(self) -> Array:
        """Return estimate minus truth at t = 0, north and east (m), (1, 2)."""
        return _track(_rows(self._estimate, 3), ZERO) - _track(_rows(self._truth, 3), ZERO)

    def _references(self, at: Array, start: Array) -> Array:
        """Return the reference of the newest plan at each time, (K, 2); before the first plan, that of the first.

        On a path it moves linearly from the first knot of one plan to that of the next.
        """
        rows = _rows(self._reference, 5)
        if not len(rows):
            return np.broadcast_to(start, (len(at), 2))
        newest = np.maximum(np.searchsorted(rows[:, 0], at, side="right") - 1, 0)
        positions, moves = rows[newest, 2:4], rows[newest, 4] > 0.0
        if moves.any():
            positions[moves] = _track(rows[rows[:, 4] > 0.0, 1:4], at[moves])
        return positions


class ThrustCommands:
    """Commands to the two lateral thrusters, as the actuators report them."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._velocity_mps = 0.0, 0.0  # through the water, ahead and down, at the last truth
        self._box = np.array([[t.min_N, t.max_N] for t in vehicle.thrusters])  # (3, 2): thruster, bound
        self._command = array("d")  # t, three commands, slew; the three thrusts, velocity ahead and down
        self._delivered = array("d")  # t, delivered thrusts of port and starboard

    def add(self, applied: Applied) -> None:
        """Add the command in force."""
        self._command.extend((applied.t_ns, *applied.command_N, max(applied.command_slew_N_per_s[:2])))
        self._command.extend((*applied.thrust_N, *self._velocity_mps))

    def add_truth(self, truth: Truth) -> None:
        """Add the velocity through the water, which is the inflow of the propellers, and the delivered thrust."""
        ahead, _, down = truth.water_velocity_mps
        self._velocity_mps = ahead, down
        self._delivered.extend((truth.t_ns, *truth.thrust_N[:2]))

    def thrust(self) -> Thrust:
        """Return statistics of the commands in force from t = 0 on."""
        table = _rows(self._command, 10)
        rows, delivered = np.hsplit(table[table[:, 0] >= 0.0], 2)
        if len(rows) < 2:
            return Thrust()
        h, F = np.diff(rows[:, 0]), rows[:, 1:3]  # (K-1,), (K, 2)
        limited = self._at_limits(rows[:, 1:4])
        vertical = float(np.average(limited[:, 2], weights=h)) if self._vehicle.can_dive else None
        power = propulsive_power_W(self._vehicle, delivered[:, :3], delivered[:, 3], delivered[:, 4])
        energy = None if power is None else (0.5 * (power[:-1] + power[1:]) * (h * 1e-9)[:, None]).sum(axis=0)
        relative = relative_power(self._vehicle, delivered[:, :2])
        a, b = F[:-1], F[1:]
        return Thrust(
            saturated_fraction=float(np.average(limited[:, :2].any(axis=1), weights=h)),
            max_abs_N=float(np.max(np.abs(F))),
            mean_abs_N=float(np.average(_mean_abs(a, b).mean(axis=1), weights=h)),
            travel_N=float(np.sum(np.abs(b - a))),
            max_slew_N_per_s=float(np.max(rows[1:, 4])),
            max_delivered_slew_N_per_s=self._max_delivered_slew(),
            propulsive_energy_J=None if energy is None else float(energy.sum()),
            lateral_energy_J=None if energy is None else float(energy[:2].sum()),
            relative_power=float(np.average(0.5 * (relative[:-1] + relative[1:]), weights=h)),
            vertical_saturated_fraction=vertical,
        )

    def _max_delivered_slew(self) -> float | None:
        """Return the largest rate of change of a lateral thruster's thrust from t = 0 on (N/s)."""
        rows = _rows(self._delivered, 3)
        changes = np.diff(rows[rows[:, 0] >= 0.0], axis=0)
        changes = np.abs(changes[changes[:, 0] > 0.0])
        return float((changes[:, 1:].max(axis=1) / (changes[:, 0] * 1e-9)).max()) if len(changes) else None

    def _at_limits(self, F: Array) -> npt.NDArray[np.bool_]:
        """Return where each command is at one limit from one report to the next, (K-1, 3), for commands (K, 3) in N."""
        low, high = self._box.T
        a, b = F[:-1], F[1:]
        limited: npt.NDArray[np.bool_]
        limited = (np.maximum(a, b) <= low + AT_BOX_N) | (np.minimum(a, b) >= high - AT_BOX_N)
        return limited


class ClockSpeed:
    """Speed of the vehicle clock relative to wall time."""

    def __init__(self, speed: float) -> None:
        self.speed = speed  # requested now
        self._first: Clock | None = None
        self._newest: Clock | None = None

    def add(self, clock: Clock, *_: int) -> None:
        """Add a state of the clock."""
        self.speed = clock.speed_num / clock.speed_den
        if self._first is None and clock.state is ClockState.RUNNING:
            self._first = clock
        self._newest = clock

    def reached(self) -> float | None:
        """Return vehicle seconds per wall second, from the clock's start to its last change, pauses included."""
        first, newest = self._first, self._newest
        if first is None or newest is None or newest.at_monotonic_us <= first.at_monotonic_us:
            return None
        return (newest.vehicle_ns - first.vehicle_ns) / 1e3 / (newest.at_monotonic_us - first.at_monotonic_us)


class PlanDelays:
    """Delays from an estimate to the effect of its plan."""

    def __init__(self) -> None:
        # Start of the plan and time of its estimate, by epoch and sequence, until the plant receives it.
        self._published: dict[tuple[int, int], tuple[int, int]] = {}
        self._effective_s = array("d")  # estimate to effect, vehicle and wall
        self._compute_s = array("d")  # vehicle and wall

    def add_plan(self, plan: Plan, epoch: int, sequence: int) -> None:
        """Add a plan that was published."""
        self._published[epoch, sequence] = int(plan.t_ns[0]), plan.estimate_t_ns

    def add_applied(self, applied: Applied, speed: float) -> None:
        """Add the arrival of a plan at the plant; ``speed`` is that of the clock."""
        plan = self._published.pop((applied.plan_epoch, applied.plan_sequence), None)
        if plan is not None:
            start_ns, estimate_ns = plan
            delay_s = (max(start_ns, applied.plan_received_t_ns) - estimate_ns) / 1e9
            self._effective_s.extend((delay_s, delay_s / speed))

    def add_timing(self, timing: CycleTiming, *_: int) -> None:
        """Add the times of one controller cycle."""
        self._compute_s.extend((timing.compute_ns / 1e9, timing.compute_wall_ns / 1e9))

    def compute(self, *, wall: bool = False) -> Quantiles:
        """Return the delay from the start of a cycle to the publication of its plan (s)."""
        return quantiles(_rows(self._compute_s, 2)[:, int(wall)])

    def end_to_end(self, *, wall: bool = False) -> Quantiles:
        """Return the delay from an estimate's validity time to the effect of its plan (s)."""
        return quantiles(_rows(self._effective_s, 2)[:, int(wall)])


class RunMetrics:
    """Metrics of one run. It receives all messages in order of publication and computes the figures at the end.

    Parameters
    ----------
    vehicle : thrust limits, hull.
    fence : zones from which the vehicle keeps away, until a ``FenceInForce`` names others.
    speed : speed of the clock until the first ``Clock`` message.
    in_places : the reference is given in places, and does not begin where the vehicle is.
    """

    def __init__(
        self, vehicle: Vehicle, *, fence: Fence | None = None, speed: float = 1.0, in_places: bool = False
    ) -> None:
        self.fence = FenceDistances(vehicle, fence)
        self.cycles = 0
        self.deadline_misses = 0
        self.plans_refused = 0
        self.qp_status: Counter[str] = Counter()
        self.plan_origin: Counter[str] = Counter()
        self.health: Counter[str] = Counter()
        self.track = TrackErrors(in_places=in_places)
        self.commands = ThrustCommands(vehicle)
        self.clock = ClockSpeed(speed)
        self.delays = PlanDelays()
        self._receive: dict[type[Message], Callable[[Any, int, int], None]] = {
            Truth: self._add_truth,
            FenceInForce: self.fence.add_fence,
            Estimate: self.track.add_estimate,
            Plan: self._add_plan,
            Applied: self._add_applied,
            CycleTiming: self.delays.add_timing,
            Clock: self.clock.add,
        }

    @property
    def message_types(self) -> frozenset[type[Message]]:
        """Types of the messages in use."""
        return frozenset(self._receive)

    def observe(self, signal: Message, *, epoch: int, sequence: int) -> None:
        """Receive a message with its source's epoch and its sequence number."""
        receive = self._receive.get(type(signal))
        if receive is not None:
            receive(signal, epoch, sequence)

    def _add_truth(self, truth: Truth, *_: int) -> None:
        self.track.add_truth(truth)
        self.fence.add_truth(truth)
        self.commands.add_truth(truth)

    def _add_plan(self, plan: Plan, epoch: int, sequence: int) -> None:
        self.cycles += 1
        self.fence.add_plan(plan)
        self.qp_status[plan.solve.status.value] += 1
        self.plan_origin[plan.origin.value] += 1
        self.health[with_reason(plan.health.value, plan.health_why)] += 1
        self.delays.add_plan(plan, epoch, sequence)
        self.track.add_plan(plan)

    def _add_applied(self, applied: Applied, *_: int) -> None:
        self.commands.add(applied)
        self.deadline_misses, self.plans_refused = applied.plans_late, applied.plans_rejected
        self.delays.add_applied(applied, self.clock.speed)


def quantiles(values: Sequence[float] | Array) -> Quantiles:
    """Return median, 99 % quantile and maximum; None for no values."""
    if not len(values):
        return Quantiles(median=None, p99=None, max=None)
    median, p99, top = np.quantile(values, (0.5, 0.99, 1.0))
    return Quantiles(median=float(median), p99=float(p99), max=float(top))


def _spread(error: Array) -> Spread:
    if not len(error):
        return Spread(mean=None, max=None, final=None)
    return Spread(mean=float(error.mean()), max=float(error.max()), final=float(error[-1]))


def _mean_abs(a: Array, b: Array) -> Array:
    """Return the mean of |F| while F goes linearly from a to b; (a^2 + b^2) / (2 (|a| + |b|)) if it crosses 0."""
    total = np.abs(a) + np.abs(b)
    crossing = np.divide(a * a + b * b, 2.0 * total, out=np.zeros_like(a), where=total > 0)
    return np.where(a * b < 0, crossing, 0.5 * total)


def _rows(values: array[float], columns: int) -> Array:
    return np.array(values).reshape(-1, columns)


def _track(rows: Array, at: Array) -> Array:
    """Return north and east at the times ``at``, (K, 2), linear between rows and constant beyond both ends."""
    t, north, east = rows.T
    return np.column_stack([np.interp(at, t, north), np.interp(at, t, east)])
