"""Plan for the tests of edges."""

from __future__ import annotations

import numpy as np

from ltv_mpc.messages import Plan
from tests.ltv_mpc.plans import plan_of

SECOND_NS = 1_000_000_000


def plan(t0_ns: int) -> Plan:
    """Return a plan that rises to 10, -20, 5 N within a second and holds it for another."""
    thrust_N = [[0.0, 0.0, 0.0], [10.0, -20.0, 5.0], [10.0, -20.0, 5.0]]
    return plan_of(t0_ns, thrust_N, SECOND_NS, states=np.array([[1.0, 2.0, 0.0, 0.0, 0.5, 0.0]] * 3))
