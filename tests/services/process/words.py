"""A process's word about itself, for tests of who hears it."""

from __future__ import annotations

from ltv_mpc.signals import NodeStatus


def status(node: str, behind_us: int = 0) -> NodeStatus:
    return NodeStatus(
        node=node,
        behind_us=behind_us,
        t_ns=0,
        ready=True,
        waiting_for="",
        steps=0,
        published=1,
        received=0,
        dropped=0,
        rejected=0,
        step_us=0.0,
    )
