"""Plans as a controller sends them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ltv_mpc.messages import Plan, PlanOrigin, Solve, SolveStatus


def plan_of(start_ns: int, thrust_N: ArrayLike, stage_ns: int = 300_000_000, **fields: Any) -> Plan:
    """Return a solved plan that begins with its cycle, a knot each stage, states of zero; or with other ``fields``."""
    thrust = np.asarray(thrust_N, dtype=np.float64)
    made = {
        "cycle_t_ns": start_ns,
        "t_ns": start_ns + stage_ns * np.arange(len(thrust)),
        "thrust_N": thrust,
        "states": np.zeros((len(thrust), 6)),
        "origin": PlanOrigin.SOLVED,
        "solve": Solve(status=SolveStatus.SOLVED),
    }
    return Plan(**{**made, **fields})
