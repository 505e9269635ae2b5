"""Plan for the tests of edges."""

from __future__ import annotations

import numpy as np

from ltv_mpc.messages import Plan, PlanOrigin, Solve, SolveStatus

SECOND_NS = 1_000_000_000


def plan(t0_ns: int) -> Plan:
    """Return a plan that rises to 10, -20, 5 N within a second and holds it for another."""
    return Plan(
        cycle_t_ns=t0_ns,
        t_ns=np.array([t0_ns, t0_ns + SECOND_NS, t0_ns + 2 * SECOND_NS]),
        thrust_N=np.array([[0.0, 0.0, 0.0], [10.0, -20.0, 5.0], [10.0, -20.0, 5.0]]),
        states=np.array([[1.0, 2.0, 0.0, 0.0, 0.5, 0.0]] * 3),
        origin=PlanOrigin.SOLVED,
        solve=Solve(status=SolveStatus.SOLVED),
    )
