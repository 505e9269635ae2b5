"""Extra nodes of a run: a source of disturbances, and an intruder that also commands the vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.faults.effects import Interval
from ltv_mpc.messages import Disturbance, Message, Plan, PlanOrigin, Solve, SolveStatus, Triple
from ltv_mpc.node import Grid, Inbox
from ltv_mpc.vehicle.parameters import Vehicle

PERIOD_NS = 100_000_000

INTRUDERS_STAGES = 17
INTRUDERS_STAGE_NS = 300_000_000


class DisturbanceSource:
    """Node that publishes each disturbance at its time."""

    name = "operator"
    schedule = Grid(PERIOD_NS)
    reads: tuple[type[Message], ...] = ()
    writes: tuple[type[Message], ...] = (Disturbance,)

    def __init__(self, disturbances: Sequence[tuple[int, Disturbance]]) -> None:
        """Schedule pairs of vehicle time (ns) and disturbance."""
        self._waiting = sorted(disturbances, key=lambda pair: pair[0])

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        """Return the disturbances that are due."""
        due = [disturbance for at_ns, disturbance in self._waiting if at_ns <= t_ns]
        self._waiting = self._waiting[len(due) :]
        return list(due)


class Intrusion(NamedTuple):
    """Interval in which an intruder commands a thrust."""

    interval: Interval
    thrust_N: Triple  # port, starboard, vertical


class Intruder:
    """Node that publishes unauthorised plans, each of which is valid: finite, within limits and constant."""

    name = "intruder"
    schedule = Grid(PERIOD_NS)
    reads: tuple[type[Message], ...] = ()
    writes: tuple[type[Message], ...] = (Plan,)

    def __init__(self, intrusions: Sequence[Intrusion]) -> None:
        self._intrusions = intrusions

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        """Return one plan each period of an active intrusion."""
        return [steady_plan(t_ns, one.thrust_N) for one in self._intrusions if one.interval.contains(t_ns)]


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
