"""How long a controller cycle takes on this machine, on the problems of a closed loop in lock step."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from ltv_mpc.control.config import STAGE_NS, ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.errors import ConfigError
from ltv_mpc.node import Inbox
from ltv_mpc.signals import Plan, Signal, SolveStatus
from services.process.stopwatch import StageTimer
from services.run import locked
from services.run.situation import Override, Situation, resolve
from sim.lockstep import LockStep

WARM_UP = 20
"""Cycles at the start that are left out: cold caches, and linearising more than once from a crude guess."""

TOTAL = "cycle"


class Times(msgspec.Struct, frozen=True, kw_only=True):
    """Wall time of one stage over all cycles (us)."""

    median_us: float
    p90_us: float
    p99_us: float
    max_us: float


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One horizon. ``times`` by stage, the whole cycle first."""

    horizon_s: float
    stages: int
    cycles: int
    solver: str
    solved: int
    times: dict[str, Times]


class TimedController(ControllerNode):
    """A controller whose cycles are measured from outside."""

    def __init__(self, situation: Situation) -> None:
        self.timer = StageTimer()
        self.measured: list[dict[str, float]] = []
        self.solved = 0
        super().__init__(situation.vehicle, situation.reference, situation.scenario.controller, stopwatch=self.timer)

    def step(self, t_ns: int, inbox: Inbox) -> list[Signal]:
        """One cycle, measured."""
        self.timer.start()
        outputs = super().step(t_ns, inbox)
        plans = [signal for signal in outputs if isinstance(signal, Plan)]
        if any(plan.solve.status is not SolveStatus.NOT_RUN for plan in plans):
            self.measured.append(self.timer.stage_us)
            self.solved += any(plan.solve.status is SolveStatus.SOLVED for plan in plans)
        return outputs


def parse_horizons(text: str) -> list[str]:
    """``2.5,5,10`` as texts, each of which the key controller.horizon_s will judge."""
    horizons = [part.strip() for part in text.split(",")]
    if not all(horizons):
        raise ConfigError("option --horizons", "", "must be seconds with commas between, as in 2.5,5,10", value=text)
    return horizons


def situations(horizons: Sequence[str], *, cycles: int, seed: str) -> list[Situation]:
    """The paper's descent, as long as the cycles need, at each horizon. Raises ``ConfigError``."""
    period_s = ControllerConfig().period_s
    common = [f"run.duration_s={(cycles + WARM_UP + 1) * period_s:.3f}", "run.perfect_state=true"]
    return [
        resolve(
            "descent",
            [
                Override("option --seed", [f"run.seed={seed}"]),
                Override("option --cycles", common),
                Override("option --horizons", [f"controller.horizon_s={horizon}"]),
            ],
        )
        for horizon in horizons
    ]


def measure(situation: Situation, *, cycles: int) -> Row:
    """One horizon's row."""
    controller = TimedController(situation)
    nodes = [controller if node.name == controller.name else node for node in locked.nodes(situation)]
    LockStep(nodes, start_ns=situation.scenario.start_ns, latest=locked.LATEST).advance(situation.scenario.end_ns)
    kept = controller.measured[WARM_UP : WARM_UP + cycles]
    config = situation.scenario.controller
    names = list(dict.fromkeys(name for cycle in kept for name in cycle))
    times = {TOTAL: _times([sum(cycle.values()) for cycle in kept])}
    times |= {name: _times([cycle.get(name, 0.0) for cycle in kept]) for name in names}
    return Row(
        horizon_s=config.stages * STAGE_NS * 1e-9,
        stages=config.stages,
        cycles=len(kept),
        solver=config.solver,
        solved=controller.solved,
        times=times,
    )


def measure_all(situations: Sequence[Situation], *, cycles: int, progress: Callable[[str], None]) -> list[Row]:
    """A row for each situation."""
    rows = []
    for situation in situations:
        progress(f"horizon {situation.scenario.controller.horizon_s:g} s: {cycles} cycles")
        rows.append(measure(situation, cycles=cycles))
    return rows


def table(rows: Sequence[Row]) -> str:
    """For people, in milliseconds."""
    lines = [
        f"{'horizon':>8} {'stages':>6} {'cycles':>6}  {'stage':<10} {'median':>9} {'p90':>9} {'p99':>9} {'max':>9}  ms"
    ]
    for row in rows:
        for i, (name, t) in enumerate(row.times.items()):
            head = f"{row.horizon_s:>6.1f} s {row.stages:>6} {row.cycles:>6}" if i == 0 else " " * 22
            figures = " ".join(f"{us / 1000:>9.3f}" for us in (t.median_us, t.p90_us, t.p99_us, t.max_us))
            lines.append(f"{head}  {name:<10} {figures}")
    return "\n".join(lines)


def _times(us: Sequence[float]) -> Times:
    median, p90, p99, most = np.quantile(np.array(us), [0.5, 0.9, 0.99, 1.0]).tolist()
    return Times(median_us=median, p90_us=p90, p99_us=p99, max_us=most)
