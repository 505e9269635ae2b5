"""A process's word about itself, for tests of who hears it."""

from __future__ import annotations

from typing import Any

from ltv_mpc.messages import NodeStatus


def status(node: str, **what: Any) -> NodeStatus:
    """Of a process that is ready and has done nothing, but for ``what``."""
    counts = dict.fromkeys(("steps", "published", "received", "dropped", "rejected"), 0)
    return NodeStatus(**{"node": node, "t_ns": 0, "ready": True, "waiting_for": "", "step_us": 0.0, **counts, **what})
