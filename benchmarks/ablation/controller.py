"""Mechanisms of controller, solvers, safety and references."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import msgspec

from benchmarks.ablation import controller_events as events
from benchmarks.ablation.mechanism import Event, Mechanism, replaced
from ltv_mpc.control import horizon_selection, lateral, resolution
from ltv_mpc.control.config import ControllerConfig, Disturbance, Weights
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.delay import Delay
from ltv_mpc.control.fallback import Fallback
from ltv_mpc.control.horizon_selection import proposed_horizon_s
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.control.solvers import osqp, osqp_workspace
from ltv_mpc.control.solvers.osqp import OsqpSolver
from ltv_mpc.control.vertical import VerticalLaw
from ltv_mpc.messages import Estimate, MessageFault, Plan
from ltv_mpc.references import follower
from ltv_mpc.references.schedule import fill_targets
from ltv_mpc.safety import health, thrust_loss_detector
from ltv_mpc.safety.estimate_gate import EstimateGate
from ltv_mpc.safety.input_monitor import InputMonitor
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict

Switch = Callable[[], AbstractContextManager[Any]]


def without(*changes: tuple[object, str, object]) -> Switch:
    """Return a switch that sets these attributes."""
    return lambda: replaced(*changes)


def settings(**values: Any) -> Switch:
    """Return a switch that sets these settings of every controller."""
    made = Controller.__init__

    def init(self: Controller, vehicle: Any, reference: Any, config: Any = None, **others: Any) -> None:
        made(self, vehicle, reference, msgspec.structs.replace(config or ControllerConfig(), **values), **others)

    return without((Controller, "__init__", init))


# --- solver ---


def forget(self: OsqpSolver, _stages: float) -> None:
    """Forget the duals instead of shifting them."""
    self.reset_warm_start()


def public(*arguments: Any) -> osqp_workspace.PublicWorkspace:
    """Make OSQP's public wrapper."""
    return osqp_workspace.PublicWorkspace(*arguments)


# --- fallback levels ---


def nothing(*_: Any, **__: Any) -> None:
    """Do nothing."""


# --- delay, commands, prediction ---


def largest(self: Delay) -> None:
    """Expect the largest delay measured lately."""
    measured = self._receipts or self._computing
    self._expected_ns = max(*measured, self._min_ns, 0)


def median(self: Delay) -> None:
    """Expect the median delay."""
    measured = sorted(self._receipts or self._computing)
    self._expected_ns = measured[len(measured) // 2]


def no_delay(self: Delay) -> int:
    """Expect none."""
    del self
    return 0


# --- safety ---


def believe(self: EstimateGate, estimate: Estimate) -> str:
    """Believe every estimate."""
    self.accepted = estimate
    return ""


def accept(*_: Any) -> PlanVerdict:
    """Accept every plan."""
    return PlanVerdict.ACCEPTED


def receive_all(self: InputMonitor, *, epoch: int, sequence: int, stamp_ns: int, received_ns: int) -> bool:
    """Take every message for news."""
    if self._stamp_ns is None or stamp_ns != self._stamp_ns:
        self.period.add(stamp_ns)
    self._epoch, self._sequence, self._stamp_ns, self._received_ns = epoch, sequence, stamp_ns, received_ns
    return True


def seconds_alone(_periods: float, _period_ns: int, least_s: float) -> int:
    """Allow the seconds of the settings, whatever the period."""
    return round(least_s * 1e9)


def no_evidence(*_: Any) -> tuple[float, float, float]:
    """Find no evidence of a loss."""
    return 0.0, 0.0, 0.0


# --- references ---

_advance_target = follower.advance_target


def unleashed(table: Any, tau: float, t_ns: Any, lateral: Any, *others: Any) -> Any:
    """Let the target go on whatever the distance and the current."""
    target = others[-1]
    _, *rest = _advance_target(table, tau, t_ns, lateral, *others)
    fill_targets(table, tau, 1.0, t_ns, target)
    return (1.0, *rest)


def without_against(table: Any, tau: float, t_ns: Any, lateral: Any, _current: Any, *others: Any) -> Any:
    """Let the target go on as if there were no current."""
    return _advance_target(table, tau, t_ns, lateral, (0.0, 0.0), *others)


def paper_weights(_vehicle: Any) -> Weights:
    """Return the weights of the paper's vehicle."""
    return Weights()


# --- events ---

E = events
NOMINAL = Event("descent", "descent, 5.1 s of horizon", E.descent())
SHORT = Event("short horizon", "descent, 2.5 s of horizon", E.descent("controller.horizon_s=2.5"))
FAR_OFF = Event("far off", "start 5 m off the line, any heading", E.far_off)
DRAWN = Event("drawn 2", "randomly drawn vehicle holds a point in 0.35 of its top speed", E.drawn_vehicle)
LIGHT = Event("light", "drawn vehicle, light to the side, holds a point", E.light_vehicle)
UNTOLD = Event("untold", "estimates without a profile, 4 cm/s at all depths", E.untold("constant"))
UNTOLD_PROFILE = Event("untold profile", "estimates without a profile, Gauss-Markov current", E.untold("profile"))
MISTOLD = Event("mistold", "profile told lacks 4 cm/s at all depths", E.mistold)
HALF = Event("half thrust", "port delivers half of what it reports", E.half_thrust)
WAVES = Event("waves", "internal waves of 5 cm/s, told", E.waves)
FAILS = Event("solver fails", "the solver fails for 3 s", E.solver_fails(20.0, 3.0))
SLOW = Event("slow estimates", "an estimate each 2 s", E.slow_estimates)
NONSENSE = Event("nonsense 2", "one estimate in ten is of another place, covariance 0.1 m", E.nonsense)
TIGHT = Event("tight limits", "yaw rate <= 0.1 rad/s, surge <= 0.1 m/s", E.tight_limits)
CYCLES = Event("cycles", "descent", E.nominal_cycles())
CYCLES_20 = Event("cycles 20 s", "descent, 20.1 s of horizon", E.nominal_cycles("controller.horizon_s=20.1"))
CYCLES_HARD = Event("hard cycles", "start 5 m off the line, any heading", E.hard_cycles)
CYCLES_TIGHT = Event("tight cycles", "yaw rate <= 0.1 rad/s, surge <= 0.1 m/s", E.nominal_cycles(*E.LIMITS))
BALLAST = Event("ballast", "ballast 3 to 8 N off; down to 8 m and stay", E.ballast)
SQUARE = Event("square", "square at 1 m/s in 0.3 m/s, start 6 m off", E.square(0.3, 6.0))
CALM_SQUARE = Event("calm square", "square at 1 m/s, 0.05 m/s, start on it", E.square(0.05, 0.0))
FAILS_SQUARE = Event(
    "solver fails on square", "square at 1 m/s, the solver fails for 12 s", E.square(0.05, 0.0, fails_s=12.0)
)
LOST_PLANS = Event("lost plans", "half of the plans lost, 10 s", E.harmed(Plan, MessageFault.LOSS, 0.5))
TAKEN_OVER = Event(
    "taken over", "start 5 m off; at 3 s a controller takes over with a state of 3 s ago", E.taken_over(with_plan=True)
)
TAKEN_OVER_BLIND = Event(
    "taken over without a plan",
    "start 5 m off; at 3 s a controller takes over without the plan in force",
    E.taken_over(with_plan=False),
)
LATE_FAR_OFF = Event("late far off", "start 5 m off; cycles take 1 s from 3 to 9 s", E.late_far_off)
DELAY = Event("delay", "0.71 s of computing each cycle", E.constant_delay)
SCATTER = Event("scattered delay", "computing 0.1 s at the median, 0.3 s at 99 %", E.scattered_delay)
OVERRUN = Event("overrun", "computing takes 0.5 to 1.5 s for 6 s", E.overrun)
CORRUPT_ESTIMATE = Event(
    "corrupt estimate", "bits of each estimate turned, 10 s", E.harmed(Estimate, MessageFault.CORRUPTION, 1.0)
)
REORDER = Event(
    "reorder", "four estimates in ten after their successor, 10 s", E.harmed(Estimate, MessageFault.REORDER, 0.4)
)
JUMP = Event(
    "clock jump", "stamps of estimates an hour ahead, 10 s", E.harmed(Estimate, MessageFault.CLOCK_JUMP, 3600.0)
)
JUMP_BACK = Event("clock back", "stamps of estimates 5 s back, 10 s", E.harmed(Estimate, MessageFault.CLOCK_JUMP, -5.0))
CORRUPT_PLAN = Event("corrupt plan", "bits of each plan turned, 10 s", E.harmed(Plan, MessageFault.CORRUPTION, 1.0))
INTRUDED = Event("intruded 2", "a second commander, full ahead, for 4 s", E.intruded)
WEAK = Event("weak thruster", "a thruster delivers 30 % of what it reports for 50 s", E.weak_thruster)
LOSS = Event("thrust lost", "30 % of thrust lost for 8 s, every 30 s", E.thrust_lost)
MISMATCH = Event("mismatch", "mass, drag, thrust off by 10 %", E.mismatched)

TRUE = "true error, rms (m)"
ERROR = (TRUE, "true error, 95 % (m)", "mean thrust (N)", "saturated (%)")
EVENT = (TRUE, "true error, largest (m)", "recovery (s)", "cycles solved (%)")
TIME = ("cycle, median (us)", "cycle, 99 % (us)", "iterations, mean", TRUE, "cycles solved (%)")
JUNCTION = ("largest jump (N)", "mean jump (N)", "true error in the window, rms (m)", "plans refused", "late plans (%)")
LOCKED = (TRUE, "true error, largest (m)", "recovery (s)", "late plans (%)", "bad thrusts (%)")
HELD = ("largest distance, last 40 s (m)", "settled after (s)")
EXCURSION = ("cross-track error, largest after 30 s (m)", "cross-track error, rms (m)", "path done after (s)")
PATH = ("cross-track error, rms (m)", "cross-track error, 95 % (m)", "path done after (s)")


def row(
    name: str,
    event: Event,
    off: Switch,
    measures: tuple[str, ...],
    *,
    timed: bool = False,
) -> Mechanism:
    """Return a mechanism; its name is followed by that of its event, so that it is unique."""
    return Mechanism(f"{name} [{event.name}]", event, off, measures, timed)


MECHANISMS: tuple[Mechanism, ...] = (
    row("commands reported", TAKEN_OVER, without((SentCommands, "correct", nothing)), JUNCTION),
    row("commands reported", TAKEN_OVER_BLIND, without((SentCommands, "correct", nothing)), JUNCTION),
    row("commands reported", LATE_FAR_OFF, without((SentCommands, "correct", nothing)), JUNCTION),
    row("second QP", NOMINAL, settings(sqp_iterations=1), ERROR),
    row("second QP", SHORT, settings(sqp_iterations=1), ERROR),
    row("second QP", FAR_OFF, settings(sqp_iterations=1), EVENT),
    row("second QP", CYCLES, settings(sqp_iterations=1), TIME, timed=True),
    row("current bias", UNTOLD, settings(disturbance=Disturbance(sd_mps=0.0)), ERROR),
    row("current bias", UNTOLD_PROFILE, settings(disturbance=Disturbance(sd_mps=0.0)), ERROR),
    row("current bias always on", MISTOLD, settings(disturbance=Disturbance()), ERROR),
    row("current bias always on", HALF, settings(disturbance=Disturbance()), ERROR),
    row("current bias always on", WAVES, settings(disturbance=Disturbance()), ERROR),
    row("rescaling between turns", CYCLES_TIGHT, without((osqp, "BATCH", 4000)), TIME, timed=True),
    row("rescaling between turns", CYCLES_HARD, without((osqp, "BATCH", 4000)), TIME, timed=True),
    row("shifted duals", CYCLES, without((OsqpSolver, "shift_warm_start", forget)), TIME, timed=True),
    row("shifted duals", CYCLES_HARD, without((OsqpSolver, "shift_warm_start", forget)), TIME, timed=True),
    row("shifted duals", CYCLES_TIGHT, without((OsqpSolver, "shift_warm_start", forget)), TIME, timed=True),
    row("raw OSQP extension", CYCLES, without((osqp, "make_workspace", public)), TIME, timed=True),
    row("growing stages", CYCLES_20, settings(max_stages=400), TIME, timed=True),
    row(
        "stability of the proposed horizon",
        LIGHT,
        without(
            (resolution, "proposed_horizon_s", proposed_horizon_s.__wrapped__),  # not the one in its cache
            (horizon_selection, "STABLE_SHARES", ()),
        ),
        ("largest distance, last 40 s (m)", "sway, rms (m)", "change of thrust, rms", "horizon (s)"),
    ),
    row(
        "weights from the vehicle",
        DRAWN,
        without((resolution, "default_weights", paper_weights)),
        (*HELD, "sway, rms (m)", "change of thrust, rms", "iterations, largest", "cycles not solved"),
    ),
    row("shifted plan", FAILS_SQUARE, without((Fallback, "shift", nothing)), EXCURSION),
    row("shifted plan", FAILS, without((Fallback, "shift", nothing)), EVENT),
    row("use of solves that ended early", TIGHT, without((lateral, "is_usable", lambda *_: False)), EVENT),
    row(
        "depth integral",
        BALLAST,
        without((VerticalLaw, "advance_integral", nothing)),
        ("depth error, rms (m)", "depth error, last 30 s, mean size (m)"),
    ),
    row("delay prediction", DELAY, without((Delay, "expected_ns", no_delay)), LOCKED),
    row("delay quantile, against the median", SCATTER, without((Delay, "_update", median)), LOCKED),
    row("delay quantile, against the largest", SCATTER, without((Delay, "_update", largest)), LOCKED),
    row("delay quantile, against the largest", OVERRUN, without((Delay, "_update", largest)), LOCKED),
    row("commands reported", OVERRUN, without((SentCommands, "correct", nothing)), LOCKED),
    row("commands reported", INTRUDED, without((SentCommands, "correct", nothing)), LOCKED),
    row("commands reported", LOST_PLANS, without((SentCommands, "correct", nothing)), LOCKED),
    row("thrust reported", NOMINAL, without((Prediction, "add_report", nothing)), ERROR),
    row("thrust reported", OVERRUN, without((Prediction, "add_report", nothing)), LOCKED),
    row("thrust reported", HALF, without((Prediction, "add_report", nothing)), ERROR),
    row("estimate gate", NONSENSE, without((EstimateGate, "check", believe)), EVENT),
    row("estimate gate", CORRUPT_ESTIMATE, without((EstimateGate, "check", believe)), LOCKED),
    row("input monitor: order", REORDER, without((InputMonitor, "receive", receive_all)), LOCKED),
    row("input monitor: clock", JUMP, without((InputMonitor, "receive", receive_all)), LOCKED),
    row("input monitor: clock", JUMP_BACK, without((InputMonitor, "receive", receive_all)), LOCKED),
    row(
        "ages in periods",
        SLOW,
        without((health, "timeout_ns", seconds_alone)),
        EVENT,
    ),
    row("plan gate", CORRUPT_PLAN, without((PlanGate, "_check", accept)), LOCKED),
    row("plan gate", INTRUDED, without((PlanGate, "_check", accept)), LOCKED),
    row(
        "thrust-loss detector",
        LOSS,
        without((thrust_loss_detector, "evaluate", no_evidence)),
        ("losses detected (%)", "delay, median (s)"),
    ),
    row(
        "what was learned before",
        LOSS,
        without((thrust_loss_detector, "accumulate", nothing)),
        ("losses detected (%)", "delay, median (s)"),
    ),
    row(
        "what was learned before",
        MISMATCH,
        without((thrust_loss_detector, "accumulate", nothing)),
        ("false alarms", "largest evidence (nats)"),
    ),
    row("reduced box of a weak thruster", WEAK, settings(reduce_weak_thruster=False), LOCKED),
    row("leash and current", SQUARE, without((follower, "advance_target", unleashed)), PATH),
    row("current in the schedule", SQUARE, without((follower, "advance_target", without_against)), PATH),
    row("current in the schedule", CALM_SQUARE, without((follower, "advance_target", without_against)), PATH),
)
