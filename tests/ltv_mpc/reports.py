"""Reports of actuators."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ltv_mpc.messages import Applied


def report(t_ns: int, thrust_N: Iterable[float], command_N: Iterable[float] | None = None, **fields: Any) -> Applied:
    """Thrust delivered (3,), and the command in force (3,): the same, if left out; or other ``fields``."""
    thrust = tuple(map(float, thrust_N))
    made = {
        "command_N": thrust if command_N is None else tuple(map(float, command_N)),
        "command_slew_N_per_s": (0.0, 0.0, 0.0),
        **{"plan_epoch": 0, "plan_sequence": -1, "plan_cycle_t_ns": 0, "plan_received_t_ns": 0},
        **{"plan_late": False, "plans_late": 0, "plans_rejected": 0},
    }
    return Applied(t_ns=t_ns, thrust_N=thrust, **{**made, **fields})
