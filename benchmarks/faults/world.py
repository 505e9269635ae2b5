"""Extra nodes of a run: a source of disturbances, and an intruder that also commands the vehicle."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from benchmarks.faults.effects import Interval
from ltv_mpc.messages import Message, Plan, PlanOrigin, Solve, SolveStatus, Triple
from ltv_mpc.node import Grid, Inbox
from ltv_mpc.vehicle.parameters import Vehicle

PERIOD_NS = 100_000_000

INTRUDERS_STAGES = 17
INTRUDERS_STAGE_NS = 300_000_000


class Script:
    """Node that publishes each of its messages at its time."""

    schedule = Grid(PERIOD_NS)
    reads: tuple[type[Message], ...] = ()

    def __init__(self, name: str, kind: type[Message], messages: Iterable[tuple[int, Message]]) -> None:
        """Schedule pairs of vehicle time (ns) and message."""
        self.name, self.writes = name, (kind,)
        self._waiting = sorted(messages, key=lambda pair: pair[0])

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        """Return the messages that are due."""
        due = [message for at_ns, message in self._waiting if at_ns <= t_ns]
        self._waiting = self._waiting[len(due) :]
        return due


INTRUDER = "intruder"


def intrusion(interval: Interval, thrust_N: Triple) -> list[tuple[int, Plan]]:
    """Return the plans of an intruder, each with its time: valid ones of a constant thrust, one each period."""
    return [(t_ns, steady_plan(t_ns, thrust_N)) for t_ns in range(_grid(interval.start_ns), interval.end_ns, PERIOD_NS)]


def _grid(t_ns: int) -> int:
    """Return the first time of the node's grid from ``t_ns`` on."""
    return -(-t_ns // PERIOD_NS) * PERIOD_NS


def steady_plan(t_ns: int, thrust_N: Triple) -> Plan:
    """Return a plan of constant thrust from ``t_ns`` on."""
    knots = t_ns + INTRUDERS_STAGE_NS * np.arange(INTRUDERS_STAGES + 1)
    return Plan(
        cycle_t_ns=t_ns,
        t_ns=knots,
        thrust_N=np.tile(np.array(thrust_N), (len(knots), 1)),
        states=np.zeros((len(knots), 6)),
        origin=PlanOrigin.SOLVED,
        solve=Solve(status=SolveStatus.SOLVED),
        estimate_t_ns=t_ns,
    )


def thrust_at(vehicle: Vehicle, share: Sequence[float]) -> Triple:
    """Return thrusts (N) at these shares, -1 to 1, of each thruster's limit."""
    port, starboard, vertical = (
        s * (t.max_N if s > 0 else -t.min_N) for s, t in zip(share, vehicle.thrusters, strict=True)
    )
    return port, starboard, vertical
