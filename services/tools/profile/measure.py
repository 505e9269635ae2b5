"""Interleaved measurement of solvers: each cycle of a closed loop is solved by every candidate, in random order.

One controller drives the loop. Before each cycle every candidate receives the driver's state, so that prediction,
guess and linearisation are the same for all; warm starts are each solver's own. So all solve the same problems
under the same load of the machine. Their ratios can be compared, where single times cannot.

Each cycle is measured in three states of the caches:

    interleaved  after the other candidates' cycles
    repeated     the same cycle again at once: code and data are in the caches
    flushed      after ``FLUSH_BYTES`` of other memory were written: nothing is
"""

from __future__ import annotations

import copy
import gc
import random
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control.config import ControllerConfig, ResolvedConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.problem_data import CHANGES, COMMANDS
from ltv_mpc.control.scaling import thrust_scale
from ltv_mpc.control.solvers import Solver, SolverFactory, make, solve_qp
from ltv_mpc.control.solvers.recorder import RecordingSolver
from ltv_mpc.control.solvers.sparse import solution_of, sparse_qp
from ltv_mpc.messages import Array, Estimate, Plan, Solve, SolveStatus
from ltv_mpc.vehicle.parameters import Vehicle
from services.runtime.stage_timer import StageTimer
from services.tools.profile.problems import Episode, length_s

STAGES = ("predict", "linearise", "build", "solve", "read")

REFERENCE = "piqp"
"""Backend of qpsolvers whose solution thrusts are compared with, to a tolerance of 1e-10."""

FLUSH_BYTES = 1 << 26
"""Memory that is written to flush the caches: more than the last cache of a core's share."""


class Candidate(NamedTuple):
    """Solver to be measured: its name in tables, and what makes it for a controller."""

    name: str
    make_solver: SolverFactory


def solver_by_name(name: str) -> Candidate:
    """Return a solver that ``[controller] solver`` can name."""
    return Candidate(name, lambda vehicle, config: make(vehicle, msgspec.structs.replace(config, solver=name)))


class Samples:
    """Measurements of one candidate at one horizon, one entry for each cycle."""

    def __init__(self, config: ResolvedConfig) -> None:
        self.stages = config.stages  # N
        self.horizon_s = length_s(config)
        self.cycle_us: list[float] = []  # interleaved, as stage_us
        self.repeated_us: list[float] = []
        self.flushed_us: list[float] = []
        self.stage_us: dict[str, list[float]] = {stage: [] for stage in STAGES}
        self.iterations: list[int] = []
        self.thrust_error_N: list[float] = []  # of the first free knot; NaN: there was no finite answer
        self.status: Counter[SolveStatus] = Counter()


def measure(
    episodes: Sequence[Episode],
    candidates: Sequence[Candidate],
    *,
    warm_up: Episode,
    order: random.Random,
    progress: Callable[[], None],
) -> list[Samples]:
    """Measure each candidate over all episodes of one horizon.

    ``progress`` is called after each cycle, also of the warm-up.
    """
    samples, unused = ([Samples(of.config) for _ in candidates] for of in (episodes[0], warm_up))
    for episode, into in ((warm_up, unused), *((episode, samples) for episode in episodes)):
        controllers = [_MeasuredController(who, episode, of) for who, of in zip(candidates, into, strict=True)]
        bench = _Bench(episode, controllers, order, progress)
        gc.collect()  # then not during cycles, as in the service: the bench collects between them
        gc.freeze()
        gc.disable()
        try:
            episode.feed(bench, bench.is_done)
        finally:
            gc.enable()
            gc.unfreeze()
    return samples


class _Bench(ControllerNode):
    """Node in the controller's place: it publishes the driver's plans and measures the candidates."""

    def __init__(
        self,
        episode: Episode,
        controllers: Sequence[_MeasuredController],
        order: random.Random,
        progress: Callable[[], None],
    ) -> None:
        super().__init__(episode.vehicle, episode.reference, episode.config)
        self._left = episode.cycles
        self._controllers = controllers
        self._order = order
        self._progress = progress
        self._begun = False
        self._other_memory = np.zeros(FLUSH_BYTES // 8)

    def is_done(self) -> bool:
        """Return True when all cycles of the episode are measured."""
        return self._left <= 0

    def cycle(self, estimate: Estimate, t_ns: int) -> Plan:
        """Run one cycle of every candidate and of the driver; when the episode is measured, of the driver alone."""
        driver = self.controller
        if self.is_done():
            return driver.plan(estimate, t_ns=t_ns)
        order = self._order.sample(self._controllers, len(self._controllers))
        laps = [[controller.timed(driver, estimate, t_ns) for _ in ("interleaved", "repeated")] for controller in order]
        for controller, own in zip(order, laps, strict=True):
            self._other_memory += 1.0
            own.append(controller.timed(driver, estimate, t_ns))
        plan = driver.plan(estimate, t_ns=t_ns)
        if plan.solve.status is not SolveStatus.NOT_RUN:
            if self._begun:  # the first cycle starts from a crude guess
                problem = order[0].recorded.problem  # the same for all
                exact = solution_of(problem, solve_qp(sparse_qp(problem), REFERENCE).x)
                for controller, own in zip(order, laps, strict=True):
                    controller.keep(own, exact)
                self._left -= 1
                self._progress()
            self._begun = True
        gc.collect(1)
        return plan


class Lap(NamedTuple):
    """One cycle: its solve, its time, and that of its stages."""

    solve: Solve
    us: float
    stage_us: dict[str, float]


class _MeasuredController:
    """Controller of one candidate, whose cycles are measured."""

    def __init__(self, candidate: Candidate, episode: Episode, into: Samples) -> None:
        self.timer = StageTimer()
        self._make_solver = candidate.make_solver
        self.recorded: RecordingSolver
        parts = episode.vehicle, episode.reference, episode.config
        self.controller = Controller(*parts, make_solver=self._make_recorded, stopwatch=self.timer)
        self._into = into
        self._largest_N = thrust_scale(episode.vehicle)

    def _make_recorded(self, vehicle: Vehicle, config: ControllerConfig) -> Solver:
        self.recorded = RecordingSolver(self._make_solver(vehicle, config))
        return self.recorded

    def timed(self, driver: Controller, estimate: Estimate, t_ns: int) -> Lap:
        """Run one cycle of the driver's state."""
        controller, timer = self.controller, self.timer
        controller.restore(driver.save(t_ns), t_ns)
        controller.observer = copy.deepcopy(driver.observer)
        started_ns = time.monotonic_ns()
        timer.start()
        plan = controller.plan(estimate, t_ns=t_ns)
        return Lap(plan.solve, (time.monotonic_ns() - started_ns) / 1000, timer.stage_us)

    def keep(self, laps: Sequence[Lap], exact: Array) -> None:
        """Record a cycle in three states of the caches, whose problem has the solution ``exact`` (N+1, 12)."""
        into, (interleaved, repeated, flushed) = self._into, laps
        into.cycle_us.append(interleaved.us)
        into.repeated_us.append(repeated.us)
        into.flushed_us.append(flushed.us)
        for stage, sample in into.stage_us.items():
            sample.append(interleaved.stage_us.get(stage, 0.0))
        into.iterations.append(interleaved.solve.iterations)
        into.status[interleaved.solve.status] += 1
        off = self.recorded.result.z[1] - exact[1]
        error = np.abs(off[COMMANDS:CHANGES] * self._largest_N).max()
        into.thrust_error_N.append(float(error) if np.isfinite(error) else np.nan)
