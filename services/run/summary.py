"""Summary of a run, from its metrics or from its recording."""

from __future__ import annotations

import contextlib
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.resolution import settled
from ltv_mpc.currents import WaterPrior
from ltv_mpc.messages import ControllerStatus, Estimate, Message, NodeStatus, RejectedFrame, RunEvent
from services.bus.roles import RECORDER, ROUTER, SUPERVISOR
from services.recording.acceptance import Acceptance
from services.recording.reader import Recording
from services.recording.writer import ENDED
from services.run.run_config import RunConfig
from services.run.water import EstimatedCurrent
from sim.evaluation.further import further
from sim.evaluation.metrics import RunMetrics, quantiles
from sim.evaluation.summary import Messages, Summary
from sim.plant import PERIOD_NS

SERVICES = "services"
LOCKSTEP = "lockstep"
STOPPED = "stopped early; the messages recorded so far are kept"
"""Why a run ended that a signal has stopped."""

LOOK_S, FOLLOW_S = 0.1, 0.5
"""Intervals in which the end is waited for, and in which a file that grows is looked at: it is flushed as often."""

PROCESSES = frozenset((ROUTER, RECORDER, "plant", "sensors", "estimator", "controller"))
"""Processes of a run: only their statuses and rejections count, not those of programs beside it."""


def metrics_of(run_config: RunConfig) -> RunMetrics:
    """Return the metrics of a run before its first message."""
    speed, in_places = run_config.scenario.run.speed, run_config.reference.in_places
    return RunMetrics(run_config.vehicle, fence=run_config.fence, speed=speed, in_places=in_places)


def summarise(
    run_config: RunConfig, metrics: RunMetrics, *, mode: str, messages: Messages, restarts: int = 0, why: str = ""
) -> Summary:
    """Return the summary of a run whose messages ``metrics`` has observed.

    ``why`` says why it ended early; empty: it did not.
    """
    scenario = run_config.scenario
    measured = mode == SERVICES
    nothing = quantiles([])
    return Summary(
        scenario=run_config.name,
        mode=mode,
        completed=not why,
        why=why,
        seed=scenario.run.seed,
        speed=scenario.run.speed if measured else None,
        speed_reached=metrics.clock.reached() if measured else None,
        duration_s=_duration_ns(metrics.track.until_ns, scenario.end_ns) / 1e9,
        cycles=metrics.cycles,
        **metrics.track.errors(),
        in_places=run_config.reference.in_places,
        further=further(metrics.track.positions),
        thrust=metrics.commands.thrust(),
        fence=metrics.fence.figures(),
        arrived_s=metrics.track.arrived_s,
        fence_exceeded=metrics.fence.exceeded,
        compute_delay_s=metrics.delays.compute(),
        compute_delay_wall_s=metrics.delays.compute(wall=True) if measured else nothing,
        end_to_end_delay_s=metrics.delays.end_to_end(),
        end_to_end_delay_wall_s=metrics.delays.end_to_end(wall=True) if measured else nothing,
        deadline_misses=metrics.deadline_misses,
        plans_refused=metrics.plans_refused,
        qp_status=dict(sorted(metrics.qp_status.items())),
        plan_origin=dict(sorted(metrics.plan_origin.items())),
        health=dict(sorted(metrics.health.items())),
        restarts=restarts,
        messages=messages,
        stages=run_config.controller.stages,
        horizon_s=run_config.controller.reach_s,
        proposed_horizon_s=settled(ControllerConfig(), run_config.vehicle).horizon_s,
        effort=scenario.controller.effort,
        perfect_state=scenario.run.perfect_state,
    )


def _duration_ns(until_ns: int, end_ns: int) -> int:
    """Return the duration after t = 0: to the end, if the next step of the plant would lie beyond it."""
    return end_ns if until_ns + PERIOD_NS > end_ns else max(0, until_ns)


Found: TypeAlias = tuple[Summary, WaterPrior | None]
"""Summary and estimated current of a run."""


class GrowingSummary:
    """Summary of a recording that is still written, made in a thread beside it: at the end little is left to read."""

    def __init__(self, run_config: RunConfig, path: Path) -> None:
        self._recording = Recording(path)
        self._recording.parts[0].grows = self._grows
        self._found: Found | None = None
        self._ended, self._last_look = threading.Event(), False
        self._thread = threading.Thread(target=self._run, args=(run_config,), name="summary", daemon=True)
        self._thread.start()

    def result(self, progress: Callable[[float], None]) -> Found | None:
        """Return what is found in the complete file; None if that is not whole, or has been another one."""
        self._ended.set()
        (records,) = self._recording.parts
        while self._thread.is_alive():
            progress(records.position / max(records.size, 1))
            self._thread.join(LOOK_S)
        return self._found if records.whole else None

    def _run(self, run_config: RunConfig) -> None:
        with contextlib.suppress(Exception):  # the file is read again, and there it is an error
            self._found = _summarise(run_config, self._recording)

    def _grows(self) -> bool:
        """Wait for more. The last look is the one after the end."""
        more, self._last_look = not self._last_look, self._ended.wait(FOLLOW_S)
        return more


def summarise_recording(run_config: RunConfig, path: Path) -> Found:
    """Return the summary and the estimated current of a run of processes, from its run.mcap, complete or truncated.

    Only accepted messages count (``Acceptance``); restarts and losses as the recording shows them.
    """
    return _summarise(run_config, Recording(path))


def _summarise(run_config: RunConfig, recording: Recording) -> Found:
    learned = EstimatedCurrent()
    metrics = metrics_of(run_config)
    acceptance = Acceptance(run_config.vehicle, speed=run_config.scenario.run.speed)
    faults, why = 0, ""
    reported: Counter[str] = Counter()  # rejected messages on record, by process
    statuses: dict[str, dict[int, NodeStatus]] = {}  # last status by process and epoch
    kinds: set[type[Message]] = {*metrics.message_types, ControllerStatus, NodeStatus, RejectedFrame, RunEvent}
    for stored in recording.stored():
        for message, header, _ in acceptance.take(stored, kinds):
            match message:
                case RejectedFrame(node=node) if node in PROCESSES:
                    reported[node] += 1
                case NodeStatus(node=node) if node in PROCESSES:
                    statuses.setdefault(node, {})[header.epoch] = message
                case RunEvent(node=node, kind=kind, text=text) if node == SUPERVISOR:
                    faults += kind == "fault"
                    why = why or (text if kind == ENDED else "")
                case Estimate():
                    learned.update(message)
            metrics.observe(message, epoch=header.epoch, sequence=header.sequence)
    restarts = max(faults, sum(len(epochs) - 1 for epochs in statuses.values()))
    # A flood of rejections is not recorded as a whole, so the counts in the statuses matter too.
    counts = {node: sum(one.rejected for one in epochs.values()) for node, epochs in statuses.items()}
    rejected = Counter(counts) | reported  # the larger count of each process
    denied, unreadable = rejected.pop(ROUTER, 0), rejected.pop(RECORDER, 0)
    messages = Messages(
        published=acceptance.losses.published,
        dropped=acceptance.losses.missing,
        # The recorder rejects again what a reader has rejected, as do we; both matter only for what nobody reads.
        rejected=max(rejected.total(), unreadable, acceptance.rejected),
        denied=denied,
    )
    summary = summarise(run_config, metrics, mode=SERVICES, messages=messages, restarts=restarts, why=why)
    return summary, learned.prior()
