"""Summary of a run, from its metrics or from its recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from ltv_mpc.currents import WaterPrior
from ltv_mpc.messages import Estimate, NodeStatus, RejectedFrame, RunEvent
from services.bus import topics
from services.bus.roles import RECORDER, ROUTER, SUPERVISOR
from services.bus.wire import WireError
from services.recording.loss_accounting import LossAccounting
from services.recording.reader import Recording
from services.run.run_config import RunConfig
from services.run.water import EstimatedCurrent
from sim.evaluation.metrics import RunMetrics, quantiles
from sim.evaluation.summary import Messages, Summary
from sim.plant import PERIOD_NS

SERVICES = "services"
LOCKSTEP = "lockstep"

STATUS = topics.BY_TYPE[NodeStatus].key + "/"
"""Prefix of the keys of all processes' status: each further epoch is a further start."""

RESTARTS = topics.key_of(RunEvent, SUPERVISOR)
"""Key on which the supervisor reports restarts, also of processes without a status."""


def summarise(
    run_config: RunConfig, metrics: RunMetrics, *, mode: str, messages: Messages, restarts: int = 0
) -> Summary:
    """Return the summary of a run whose messages ``metrics`` has observed."""
    scenario = run_config.scenario
    measured = mode == SERVICES
    tracking, true, localisation, absolute = metrics.errors()
    nothing = quantiles([])
    return Summary(
        scenario=run_config.name,
        mode=mode,
        seed=scenario.run.seed,
        speed=scenario.run.speed if measured else None,
        speed_reached=metrics.speed_reached() if measured else None,
        duration_s=_duration_ns(metrics.until_ns, scenario.end_ns) / 1e9,
        cycles=metrics.cycles,
        tracking_error_m=tracking,
        true_error_m=true,
        localisation_error_m=localisation,
        localisation_error_absolute_m=absolute,
        thrust=metrics.thrust(),
        fence=metrics.fence(),
        arrived_s=metrics.arrived_s(),
        fence_exceeded=metrics.fence_exceeded(),
        compute_delay_s=metrics.compute_delay(),
        compute_delay_wall_s=metrics.compute_delay(wall=True) if measured else nothing,
        end_to_end_delay_s=metrics.end_to_end_delay(),
        end_to_end_delay_wall_s=metrics.end_to_end_delay(wall=True) if measured else nothing,
        stages_us=metrics.stages() if measured else {},
        deadline_misses=metrics.deadline_misses,
        plans_refused=metrics.plans_refused,
        qp_status=dict(sorted(metrics.qp_status.items())),
        plan_origin=dict(sorted(metrics.plan_origin.items())),
        health=dict(sorted(metrics.health.items())),
        restarts=restarts,
        messages=messages,
        stages=run_config.controller.stages,
        horizon_s=run_config.controller.reach_s,
        effort=scenario.controller.effort,
        perfect_state=scenario.run.perfect_state,
    )


def _duration_ns(until_ns: int, end_ns: int) -> int:
    """Return the duration after t = 0: to the end, if the next step of the plant would lie beyond it."""
    return end_ns if until_ns + PERIOD_NS > end_ns else max(0, until_ns)


def summarise_recording(
    run_config: RunConfig, path: Path, *, restarts: int = 0, unrecorded: int = 0
) -> tuple[Summary, WaterPrior | None]:
    """Return the summary and the estimated current of a run of processes, from its run.mcap, complete or truncated.

    ``restarts`` and ``unrecorded`` are counts of the supervisor for what a recording does not show.
    """
    learned = EstimatedCurrent()
    metrics = RunMetrics(run_config.vehicle, fence=run_config.fence, speed=run_config.scenario.run.speed)
    losses = LossAccounting()
    restarted = 0
    reported: Counter[str] = Counter()  # rejected messages on record, by process
    counts: dict[tuple[str, int], int] = {}  # rejected messages by process and epoch of its status
    for stored in Recording(path):
        epoch, sequence = stored.plain["epoch"], stored.plain["sequence"]
        losses.add(stored.key, epoch, sequence)
        if stored.kind is RejectedFrame:
            reported[stored.plain["node"]] += 1
        restarted += stored.key == RESTARTS and stored.plain["kind"] == "fault"
        if stored.kind is NodeStatus:
            counts[stored.plain["node"], epoch] = stored.plain["rejected"]
        if stored.kind in metrics.message_types:
            try:
                message, _ = stored.typed()
            except WireError:  # its readers have rejected it too
                continue
            metrics.observe(message, epoch=epoch, sequence=sequence, t_ns=stored.t_ns)
            if isinstance(message, Estimate):
                learned.update(message)
    rejected, denied = _rejected_and_denied(reported, counts)
    summary = summarise(
        run_config,
        metrics,
        mode=SERVICES,
        messages=Messages(
            published=losses.published,
            dropped=max(losses.missing, unrecorded),
            rejected=rejected,
            denied=denied,
        ),
        restarts=max(
            restarts,
            restarted,
            sum(starts - 1 for key, starts in losses.epochs().items() if key.startswith(STATUS)),
        ),
    )
    return summary, learned.prior()


def _rejected_and_denied(reported: Mapping[str, int], counts: Mapping[tuple[str, int], int]) -> tuple[int, int]:
    """Return the number of rejected messages and that of the router's denials.

    A flood of rejections is not recorded as a whole, so the counts in the statuses matter too. The recorder rejects
    again what a reader has rejected; its count only matters for keys that no process reads.
    """
    total: Counter[str] = Counter()
    for (node, _), count in counts.items():
        total[node] += count
    total |= Counter(reported)  # the larger count of each process
    denied, unreadable = total.pop(ROUTER, 0), total.pop(RECORDER, 0)
    return max(total.total(), unreadable), denied
