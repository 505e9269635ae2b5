"""Report of what acts: the thrusts that an edge has the thrusters deliver, zero while it has released them.

    F_i += (1 - exp(-dt / lag_i)) (u_i - F_i)       delivered thrust, from rest, of the commands u since the last report

The controller then plans from what acts, and learns nothing while the commands are not those of its plans.
"""

from __future__ import annotations

from typing import cast

import numpy as np

from ltv_mpc.messages import Applied, Array, Triple
from ltv_mpc.vehicle.parameters import Vehicle
from services.edges.plan_follower import PlanFollower

PERIOD_NS = 100_000_000


class AppliedReporter:
    """Reports of the commands of an edge, every 0.1 s."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._lag_s = np.array([max(thruster.lag_s, 1e-9) for thruster in vehicle.thrusters])
        self._thrust_N, self._command_N = np.zeros(3), np.zeros(3)
        self._t_ns = self._reported_ns = 0
        self._released = True

    def report(self, plans: PlanFollower, command_N: Array | None, t_ns: int | None, why: str = "") -> list[Applied]:
        """Take the command from ``t_ns`` on, None for released thrusters, and why. Return the report if it is due.

        It is due at once when the thrusters are released.
        """
        if t_ns is None:
            return []
        seconds = max(t_ns - self._t_ns, 0) * 1e-9
        self._thrust_N += (1.0 - np.exp(-seconds / self._lag_s)) * (self._command_N - self._thrust_N)
        self._command_N, self._t_ns = np.zeros(3) if command_N is None else np.asarray(command_N, dtype=float), t_ns
        released, self._released = self._released, command_N is None
        if 0 <= t_ns - self._reported_ns < PERIOD_NS and released >= self._released:
            return []
        self._reported_ns = t_ns
        epoch, sequence = plans.identity
        return [
            Applied(
                t_ns=t_ns,
                thrust_N=cast(Triple, tuple(self._thrust_N.tolist())),
                command_N=cast(Triple, tuple(self._command_N.tolist())),
                command_slew_N_per_s=(0.0, 0.0, 0.0),
                plan_epoch=epoch,
                plan_sequence=sequence,
                plan_cycle_t_ns=plans.cycle_t_ns,
                plan_received_t_ns=plans.received_t_ns,
                plan_late=plans.is_late,
                plans_late=plans.late,
                plans_rejected=0,
                health=plans.health(t_ns),
                why=why,
            )
        ]
