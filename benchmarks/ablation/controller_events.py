"""Runs that contain the events which mechanisms of controller, solvers, safety and references exist for.

The state is known to the controller in all of them: localisation would add its own noise to every pair.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import numpy as np

from benchmarks import model_alarm, vehicles
from benchmarks.ablation.mechanism import Measures
from benchmarks.loop import Loop, Outcome, run_config
from benchmarks.rivals.mpc import without_water
from ltv_mpc import references
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.solvers import SolverFactory, make
from ltv_mpc.messages import Applied, ControllerState, Disturbance, Estimate, Message, MessageFault, Plan
from ltv_mpc.node import Due, Inbox, Node, ReceivedMessage
from ltv_mpc.references import Point, Reference
from ltv_mpc.vehicle.parameters import Vehicle
from services.run.nodes import make_nodes
from services.run.run_config import RunConfig
from services.tools import lockstep_run
from services.tools.faults.lockstep_runs import Bus, Log
from sim.faults import world
from sim.faults.interval import Interval
from sim.faults.message_faults import MessageFaultInterval
from sim.faults.solver_faults import SolverClock, SolverFault, SolverFaultInterval, faulty_solvers
from sim.scheduler import LockStep, Observation
from sim.water import WaterColumn

S = 1_000_000_000
SAMPLES_PER_S = 100
NEAR_M = 0.2
"""Distance within which a vehicle must stay to have recovered."""

SPEED_MPS, TURN_RAD = 0.04, 2.4
"""Current that the controller is not told, and the angle by which it turns from seed to seed."""

BEGINS_S, ENDS_S = 20.0, 28.0
"""Default start and end of an event."""


def distances(distance_m: np.ndarray, ended_s: float) -> dict[str, float]:
    """Return figures of the true distance (K,) from the reference, sampled each 10 ms."""
    after = distance_m[round(ended_s * SAMPLES_PER_S) :]
    outside = np.flatnonzero(after > NEAR_M)
    return {
        "true error, rms (m)": float(np.sqrt(np.mean(distance_m**2))),
        "true error, 95 % (m)": float(np.quantile(distance_m, 0.95)),
        "true error, largest (m)": float(distance_m.max()),
        "recovery (s)": (outside[-1] + 1) / SAMPLES_PER_S if len(outside) else 0.0,
    }


def of(outcome: Outcome, ended_s: float = 0.0) -> dict[str, float]:
    """Return the figures of one flight; ``ended_s`` is the time at which the event was over."""
    plans = sum(outcome.origins.values())
    return {
        **distances(outcome.distance_m, ended_s),
        "mean thrust (N)": outcome.mean_abs_N,
        "saturated (%)": 100.0 * outcome.saturated,
        "cycles solved (%)": 100.0 * outcome.origins.get("solved", 0) / max(plans, 1),
    }


def controller_of(s: RunConfig, make_solver: SolverFactory = make) -> Controller:
    """Make the controller of a situation."""
    return Controller(s.vehicle, s.reference, s.scenario.controller, make_solver=make_solver)


def fly(s: RunConfig, ended_s: float = 0.0, **loop: Any) -> Measures:
    """Fly one situation; ``loop`` are further arguments of ``Loop``."""
    return of(Loop(run_config=s, controller=controller_of(s), **loop).fly(), ended_s)


# --- plain descents and starts ---


def line(rate_mps: float = 0.2) -> Point:
    """Return the reference down the vertical line through the origin."""
    return Point(north_m=0.0, east_m=0.0, depth_m=40.0, descent_rate_mps=rate_mps, start_s=0.0)


def starts_far_off(seed: int) -> RunConfig:
    """Return a descent that starts 5 m off, with another heading for each seed."""
    heading = f"plant.heading_rad={(seed % 8) * 0.7 - 2.8:.1f}"
    start = heading, "plant.north_m=3.0", "plant.east_m=-4.0", "run.duration_s=60.0"
    return replace(run_config(f"run.seed={seed}", *start), reference=line())


def descent(*settings: str) -> Callable[[int], Measures]:
    """Return a run of the paper's descent, the first 100 s."""
    return lambda seed: fly(run_config(f"run.seed={seed}", "run.duration_s=100.0", *settings))


def far_off(seed: int) -> Measures:
    """Start 5 m off the line with a heading that differs from seed to seed."""
    return fly(starts_far_off(seed))


def drawn_vehicle(seed: int) -> Measures:
    """Hold a point with a vehicle that was drawn at random, in a current of 0.35 of its top speed."""
    vehicle = vehicles.drawn(seed)
    held = vehicles.hold(vehicle, 0.35, seed)
    return {
        "largest distance, last 40 s (m)": held.off_m,
        "settled after (s)": held.settled_s,
        "sway, rms (m)": held.sway_m,
        "change of thrust, rms": held.thrust_change,
        "iterations, largest": float(held.worst_iterations),
        "cycles not solved": float(held.failed),
    }


def light_vehicle(seed: int) -> Measures:
    """Hold a point with a vehicle that is light to the side, whose proposed horizon is lengthened to be stable."""
    vehicle = light_to_the_side(seed)
    config = settled(ControllerConfig(), vehicle)
    held = vehicles.hold(vehicle, 0.35, seed, config)
    return {
        "largest distance, last 40 s (m)": held.off_m,
        "sway, rms (m)": held.sway_m,
        "change of thrust, rms": held.thrust_change,
        "horizon (s)": config.horizon_s,
    }


def light_to_the_side(seed: int) -> Vehicle:
    """Return a drawn vehicle whose added mass and drag to the side are small."""
    vehicle = vehicles.drawn(seed)
    p = vehicle.sway
    sway = msgspec.structs.replace(
        p, mass_kg=1.1 * vehicle.dry_mass_kg, quadratic_damping_kgpm=0.15 * p.quadratic_damping_kgpm
    )
    return msgspec.structs.replace(vehicle, sway=sway)


# --- what the controller is told ---


def untold(water: str) -> Callable[[int], Measures]:
    """Return a descent whose estimates carry no profile of the current: constant, or Gauss-Markov."""

    def run(seed: int) -> Measures:
        s = run_config(f"run.seed={seed}", "run.duration_s=100.0")
        if water == "constant":
            towards = np.array([np.cos(TURN_RAD * seed), np.sin(TURN_RAD * seed)])
            velocity = np.tile(SPEED_MPS * towards, (len(s.water.depth_m), 1))
            s = replace(s, water=WaterColumn(s.water.depth_m, velocity))
        return fly(s, told=without_water)

    return run


ALWAYS = "controller.disturbance.sd_mps=0.1"


def mistold(seed: int) -> Measures:
    """Descend with a profile that lacks 4 cm/s at all depths."""
    missing = 0.04 * np.array([math.cos(2.4 * seed), math.sin(2.4 * seed)])

    def told(estimate: Estimate) -> Estimate:
        known = estimate.current
        assert known is not None
        current = msgspec.structs.replace(
            known, north_mps=known.north_mps - missing[0], east_mps=known.east_mps - missing[1]
        )
        return msgspec.structs.replace(estimate, current=current)

    return fly(run_config(f"run.seed={seed}", "run.duration_s=100.0", ALWAYS), told=told)


def half_thrust(seed: int) -> Measures:
    """Descend with a port thruster that delivers half of what it reports."""
    s = run_config(f"run.seed={seed}", "run.duration_s=100.0", ALWAYS)
    return fly(s, share=np.array([0.5, 1.0, 1.0]))


def weak_thruster(seed: int) -> Measures:
    """Descend with a thruster that delivers 30 % of what it reports, from 30 s to 80 s."""
    scale = (0.3, 1.0, 1.0) if seed % 2 else (1.0, 0.3, 1.0)
    loss = world.DisturbanceSource([(30 * S, Disturbance(end_t_ns=80 * S, thrust_scale=scale))])
    return Locked(seed=seed, others=[loss], duration_s=110.0).run(ended_s=80.0)


def waves(seed: int) -> Measures:
    """Descend through internal waves of 5 cm/s, all of which the profile has."""
    feature = "water.feature.kind=waves", "water.feature.period_s=60"
    return fly(run_config(f"run.seed={seed}", "run.duration_s=100.0", *feature, ALWAYS))


@dataclass
class Stale:
    """Estimates that do not come while an event lasts, or come at a period of their own."""

    begins_s: float = BEGINS_S
    ends_s: float = ENDS_S
    period_s: float = 0.0
    _last: Estimate | None = None

    def __call__(self, estimate: Estimate) -> Estimate:
        """Return the newest estimate that has come."""
        t_s = estimate.t_ns * 1e-9
        last = self._last
        late = last is not None and t_s - last.t_ns * 1e-9 < self.period_s - 1e-6
        if last is not None and (late or self.begins_s <= t_s < self.ends_s):
            return last
        self._last = estimate
        return estimate


@dataclass
class Nonsense:
    """One estimate in ten is of another place and heading."""

    rng: np.random.Generator

    def __call__(self, estimate: Estimate) -> Estimate:
        """Return the estimate, or nonsense."""
        if estimate.t_ns < 5 * S or self.rng.random() > 0.1:
            return estimate
        north, east = self.rng.uniform(-50.0, 50.0, 2)
        return msgspec.structs.replace(
            estimate, north_m=float(north), east_m=float(east), heading_rad=float(self.rng.uniform(-3.0, 3.0))
        )


def with_covariance(told: Callable[[Estimate], Estimate]) -> Callable[[Estimate], Estimate]:
    """Give every estimate a covariance, as a filter does: 0.1 m, 1 cm/s, 10 mrad, 1 mrad/s."""
    covariance = np.diag(np.array([0.1, 0.1, 0.01, 0.01, 0.01, 0.001]) ** 2)
    return lambda estimate: msgspec.structs.replace(told(estimate), covariance=covariance)


def slow_estimates(seed: int) -> Measures:
    """Descend with an estimate each 2 s."""
    return fly(run_config(f"run.seed={seed}", "run.duration_s=70.0"), told=Stale(0.0, 0.0, period_s=2.0))


def nonsense(seed: int) -> Measures:
    """Descend while one estimate in ten is of another place."""
    told = with_covariance(Nonsense(np.random.default_rng(seed)))
    # The gate knows an estimate again by its identity.
    return fly(run_config(f"run.seed={seed}", "run.duration_s=60.0"), told=told)


# --- solvers ---


def solver_fails(begins_s: float, lasts_s: float, *settings: str) -> Callable[[int], Measures]:
    """Return a descent in which the solver fails for so long."""

    def run(seed: int) -> Measures:
        s = run_config(f"run.seed={seed}", "run.duration_s=70.0", *settings)
        now = SolverClock()
        ends_s = begins_s + lasts_s
        fault = SolverFaultInterval(SolverFault.FAILS, Interval(round(begins_s * S), round(ends_s * S)))
        controller = controller_of(s, faulty_solvers([fault], now))

        def told(estimate: Estimate) -> Estimate:
            now.t_ns = estimate.t_ns
            return estimate

        return of(Loop(run_config=s, controller=controller, told=told).fly(), ends_s)

    return run


LIMITS = (
    "controller.limits.min_yaw_rate_radps=-0.1",
    "controller.limits.max_yaw_rate_radps=0.1",
    "controller.limits.min_surge_mps=-0.1",
    "controller.limits.max_surge_mps=0.1",
)


def tight_limits(seed: int) -> Measures:
    """Descend with two tight limits of the motion."""
    s = run_config(f"run.seed={seed}", "run.duration_s=60.0", *LIMITS)
    solved: list[bool] = []
    controller = controller_of(s)
    loop = Loop(run_config=s, controller=controller, seen=lambda _e, p: solved.append(p.solve.status.value == "solved"))
    measures = dict(of(loop.fly()))
    measures["QPs solved to tolerance (%)"] = 100.0 * float(np.mean(solved))
    return measures


def cycle_time(s: RunConfig) -> Measures:
    """Fly twice, the first time to have everything compiled, and return the processor time of the cycles."""
    for _ in range(2):
        controller = controller_of(s)
        timed = TimedNode(controller)
        outcome = Loop(run_config=s, controller=timed).fly()  # type: ignore[arg-type]
    us = 1e6 * np.array(timed.seconds[1:])
    return {
        "cycle, median (us)": float(np.median(us)),
        "cycle, 99 % (us)": float(np.quantile(us, 0.99)),
        "iterations, mean": float(np.mean(timed.iterations)),
        **of(outcome),
    }


class TimedNode:
    """A controller whose solved cycles are timed."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.seconds: list[float] = []
        self.iterations: list[int] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._controller, name)

    def plan(self, estimate: Estimate, *, t_ns: int) -> Plan:
        """Plan, and note how long that took."""
        begun = time.thread_time()
        plan = self._controller.plan(estimate, t_ns=t_ns)
        if plan.solve.status.value != "not_run":
            self.seconds.append(time.thread_time() - begun)
            self.iterations.append(plan.solve.iterations)
        return plan


def nominal_cycles(*settings: str) -> Callable[[int], Measures]:
    """Return a timed descent."""
    return lambda seed: cycle_time(run_config(f"run.seed={seed}", "run.duration_s=60.0", *settings))


def hard_cycles(seed: int) -> Measures:
    """Return a timed start 5 m off the line."""
    return cycle_time(starts_far_off(seed))


# --- vertical ---


def ballast(seed: int) -> Measures:
    """Go down to 8 m and stay, with a ballast that is up to 8 N off what the vehicle's file says."""
    s = run_config(f"run.seed={seed}", "run.duration_s=120.0")
    off_N = float(np.random.default_rng(seed).uniform(3.0, 8.0)) * (-1.0) ** seed
    s = replace(s, reference=references.Point(north_m=0.0, east_m=0.0, depth_m=8.0, start_s=0.0))
    believed = msgspec.structs.replace(s.vehicle, net_buoyancy_N=s.vehicle.net_buoyancy_N + off_N)
    controller = Controller(believed, s.reference, s.scenario.controller)
    errors: list[tuple[float, float]] = []

    def seen(estimate: Estimate, _plan: Plan) -> None:
        wanted = controller.follower.depths(np.array([estimate.t_ns]))
        if wanted is not None and estimate.depth_m is not None:
            errors.append((estimate.t_ns * 1e-9, estimate.depth_m - float(wanted[0][0])))

    Loop(run_config=s, controller=controller, seen=seen).fly()
    t, e = np.array(errors).T
    return {
        "depth error, rms (m)": float(np.sqrt(np.mean(e**2))),
        "depth error, last 30 s, mean size (m)": float(np.abs(e[t > 90.0]).mean()),
    }


# --- references ---


def square(
    current_mps: float, off_m: float, *, silent_s: float = 0.0, fails_s: float = 0.0
) -> Callable[[int], Measures]:
    """Return a run along a square of 20 m in a current, from a start that is off its first point.

    At 30 s no estimate comes for ``silent_s``, or the solver fails for ``fails_s``.
    """

    def run(seed: int) -> Measures:
        rng = np.random.default_rng(seed)
        heading, towards, side = rng.uniform(-math.pi, math.pi, 3)
        s = run_config(
            f"run.seed={seed}",
            "run.duration_s=200.0",
            f"plant.heading_rad={heading}",
            f"plant.north_m={off_m * math.cos(side)}",
            f"plant.east_m={off_m * math.sin(side)}",
        )
        s = replace(s, reference=references.load("square"))
        depth = s.water.depth_m
        added = np.tile(current_mps * np.array([math.cos(towards), math.sin(towards)]), (len(depth), 1))
        s = replace(s, water=type(s.water)(depth, added))
        cross: list[float] = []
        done: list[float] = []

        def seen(_estimate: Estimate, plan: Plan) -> None:
            if plan.cross_track_m is not None:
                cross.append(plan.cross_track_m)
            done.append(plan.progress or 0.0)

        now, stale = SolverClock(), Stale(30.0, 30.0 + silent_s)
        fault = SolverFaultInterval(SolverFault.FAILS, Interval(30 * S, round((30.0 + fails_s) * S)))
        controller = controller_of(s, faulty_solvers([fault], now) if fails_s > 0.0 else make)

        def told(estimate: Estimate) -> Estimate:
            now.t_ns = estimate.t_ns
            return stale(estimate)

        Loop(run_config=s, controller=controller, told=told, seen=seen).fly()
        e = np.abs(np.array(cross))
        finished = np.flatnonzero(np.array(done) >= 0.999)
        return {
            "cross-track error, rms (m)": float(np.sqrt(np.mean(e**2))),
            "cross-track error, 95 % (m)": float(np.quantile(e, 0.95)),
            "cross-track error, largest after 30 s (m)": float(e[100:].max()),
            "path done after (s)": 0.3 * float(finished[0]) if len(finished) else 200.0,
        }

    return run


# --- lock step with messages ---


@dataclass
class Jumps:
    """Differences between the command in force and a plan's own command, where the plan takes over (N)."""

    plans: dict[int, Plan] = field(default_factory=dict)  # by cycle
    seen: list[tuple[int, float]] = field(default_factory=list)  # time, largest difference of the three thrusters
    refused: int = 0

    def __call__(self, message: Message) -> None:
        """Keep a plan, or compare the one accepted last with the command at its start or its later arrival."""
        match message:
            case Plan() as plan:
                self.plans[plan.cycle_t_ns] = plan
            case Applied() as applied if applied.plan_cycle_t_ns in self.plans:
                self.refused = applied.plans_rejected
                plan = self.plans[applied.plan_cycle_t_ns]
                if applied.t_ns >= max(int(plan.t_ns[0]), applied.plan_received_t_ns):
                    difference = np.abs(np.array(applied.command_N) - plan.thrust_at(applied.t_ns))
                    self.seen.append((applied.t_ns, float(difference.max())))
                    del self.plans[applied.plan_cycle_t_ns]

    def measures(self, begins_s: float, ends_s: float) -> dict[str, float]:
        """Return figures of the plans that took over between these times."""
        within = [size for t_ns, size in self.seen if begins_s * S <= t_ns < ends_s * S]
        return {
            "largest jump (N)": max(within, default=math.nan),
            "mean jump (N)": float(np.mean(within)) if within else math.nan,
            "plans refused": float(self.refused),
        }


@dataclass(kw_only=True)
class Locked:
    """A descent in lock step, state known, with the messages harmed or the computing delay varied."""

    seed: int
    harms: Sequence[MessageFaultInterval] = ()
    delay_ns: int | Callable[[int], int] = 0
    others: Sequence[Node] = ()
    around: Callable[[list[Node]], list[Node]] = list
    duration_s: float = 60.0
    settings: tuple[str, ...] = ()
    reference: Reference | None = None

    def run_config(self) -> RunConfig:
        """Make the situation of the run."""
        s = run_config(f"run.seed={self.seed}", f"run.duration_s={self.duration_s}", *self.settings)
        return s if self.reference is None else replace(s, reference=self.reference)

    def run(self, ended_s: float = 0.0, window_s: tuple[float, float] = (0.0, math.inf)) -> dict[str, float]:
        """Make the run; ``window_s`` is the time of which jumps and the error in the window are taken."""
        s = self.run_config()
        jumps = Jumps()
        log = Log(s.vehicle, jumps)
        bus = Bus(list(self.harms))
        lockstep = LockStep(
            [*self.others, *self.around(make_nodes(s))],
            start_ns=s.scenario.start_ns,
            compute_delay_ns=self.delay_ns,
            observation=Observation(log),
            latest=lockstep_run.LATEST,
            make_rejection=lockstep_run.rejected_message,
            transport=bus if self.harms or self.others else None,
        )
        lockstep.advance(s.scenario.end_ns)
        truth = np.array([row[:3] for row in log.truth])
        truth = truth[truth[:, 0] >= 0]
        t = np.arange(0.0, self.duration_s, 1.0 / SAMPLES_PER_S)
        n, e = (np.interp(t, 1e-9 * truth[:, 0], truth[:, i]) for i in (1, 2))
        plans = [p for p in log.plans if p.cycle_ns >= 0]
        return {
            **distances(np.hypot(n, e), ended_s),
            **jumps.measures(*window_s),
            "true error in the window, rms (m)": float(
                np.sqrt(np.mean(np.hypot(n, e)[(t >= window_s[0]) & (t < window_s[1])] ** 2))
            ),
            "mean thrust (N)": float(np.mean(np.abs(np.array(log.propeller_thrust)[:, 1:]))),
            "cycles solved (%)": 100.0 * float(np.mean([p.origin.value == "solved" for p in plans])),
            "late plans (%)": 100.0 * log.applied[-1][4] / len(plans),
            "bad thrusts (%)": 100.0 * float(np.mean([bad for _, bad, *_ in log.applied])),
            "damaged messages let in": float(len(bus.validators.accepted)),
        }


def harmed(kind: type[Message], harm: MessageFault, size: float) -> Callable[[int], Measures]:
    """Return a descent in which messages of this type are harmed for 10 s."""

    def run(seed: int) -> Measures:
        fault = MessageFaultInterval((kind,), harm, Interval(20 * S, 30 * S), size, seed)
        return Locked(seed=seed, harms=[fault]).run(30.0)

    return run


def intruded(seed: int) -> Measures:
    """Descend while a second commander sends plans for 4 s."""
    vehicle = run_config().vehicle
    intrusion = world.Intrusion(Interval(20 * S, 24 * S), world.thrust_at(vehicle, (0.8, 0.8, 0.0)))
    return Locked(seed=seed, others=[world.Intruder([intrusion])]).run(24.0)


class Replaced:
    """A controller node that another one replaces: armed, along the same reference.

    The other one is given the state that was saved last, at most 5 s ago, with its plan or without.
    """

    def __init__(self, make: Callable[[], Node], at_ns: int, *, with_plan: bool = False) -> None:
        self._make, self._at_ns, self._with_plan = make, at_ns, with_plan
        self._node = make()
        self._replaced = False
        self.name, self.schedule = self._node.name, self._node.schedule
        self.reads, self.writes = self._node.reads, self._node.writes
        self._state: ControllerState | None = None

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """Step the node, or the other one."""
        return [self._step(t_ns, inbox) for t_ns, inbox in due]

    def _step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        if not self._replaced and t_ns >= self._at_ns:
            self._replaced, self._node = True, self._make()
            if self._state is not None:
                state = self._state if self._with_plan else msgspec.structs.replace(self._state, plan=None)
                inbox = [ReceivedMessage(state, 1, 0, t_ns), *inbox]
        (out,) = self._node.steps([(t_ns, inbox)])
        self._state = next((m for m in out if isinstance(m, ControllerState)), self._state)
        return out


TAKEN_OVER_S = 3.0
"""Time at which another controller takes over."""


def far_off_locked(seed: int, **others: Any) -> Locked:
    """Return a run that starts 5 m off the line with any heading: thrusts are large for ten seconds."""
    heading = f"plant.heading_rad={(seed % 20) * 0.3 - 2.8:.1f}"
    start = heading, "plant.north_m=3.0", "plant.east_m=-4.0"
    return Locked(seed=seed, settings=start, reference=line(), duration_s=40.0, **others)


def taken_over(*, with_plan: bool) -> Callable[[int], Measures]:
    """Return a run in which another controller takes over while thrusts are large."""

    def run(seed: int) -> Measures:
        def around(nodes: list[Node]) -> list[Node]:
            *others, _ = nodes
            s = far_off_locked(seed).run_config()
            return [*others, Replaced(lambda: make_nodes(s)[-1], round(TAKEN_OVER_S * S), with_plan=with_plan)]

        window_s = TAKEN_OVER_S, TAKEN_OVER_S + 10.0
        return far_off_locked(seed, around=around, delay_ns=20_000_000).run(TAKEN_OVER_S, window_s)

    return run


def late_far_off(seed: int) -> Measures:
    """Start 5 m off; from 3 s on each cycle takes a second, for 6 s."""
    delay_ns = lambda t: S if 3 * S <= t < 9 * S else 20_000_000  # noqa: E731
    return far_off_locked(seed, delay_ns=delay_ns).run(9.0, (3.0, 13.0))


def constant_delay(seed: int) -> Measures:
    """Descend with 0.71 s of computing each cycle."""
    return Locked(seed=seed, delay_ns=710_000_000).run()


def scattered_delay(seed: int) -> Measures:
    """Descend with computing times drawn from a log-normal distribution, median 0.1 s, 99 % at 0.3 s."""
    rng = np.random.default_rng(seed)
    return Locked(seed=seed, delay_ns=lambda _t: round(1e8 * math.exp(0.47 * rng.standard_normal()))).run()


def overrun(seed: int) -> Measures:
    """Descend while computing takes 0.5 to 1.5 s for 6 s, and 20 ms else."""
    slow_ns = round(S * float(np.random.default_rng(seed).uniform(0.5, 1.5)))
    return Locked(seed=seed, delay_ns=lambda t: slow_ns if 20 * S <= t < 26 * S else 20_000_000).run(26.0)


def thrust_lost(seed: int) -> Measures:
    """Descend with losses of 30 % of thrust every 30 s, for 8 s each."""
    breaker = model_alarm.Breaker(seed)
    seen = model_alarm.fly((f"run.seed={5100 + seed}", "run.duration_s=100.0", "run.perfect_state=true"), breaker)
    found = list(model_alarm.of_run("known", breaker, seen, 300_000_000))
    delays = [loss.delay_s for loss in found if loss.delay_s is not None]
    return {
        "losses detected (%)": 100.0 * len(delays) / len(found),
        "delay, median (s)": float(np.median(delays)) if delays else math.nan,
    }


def mismatched(seed: int) -> Measures:
    """Descend with mass, drag and thrust off by 10 %, and nothing lost."""
    settings = (f"run.seed={5100 + seed}", "run.duration_s=100.0", "run.perfect_state=true")
    seen = model_alarm.fly((*settings, *model_alarm.mismatch(seed)), None)
    return {"false alarms": float(len(seen.alarms)), "largest evidence (nats)": seen.evidence}
