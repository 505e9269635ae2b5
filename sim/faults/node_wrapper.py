"""Base of the nodes that wrap another node: to the scheduler they look like the node inside."""

from __future__ import annotations

from ltv_mpc.messages import Message
from ltv_mpc.node import Node, Schedule


class NodeWrapper:
    """Node with the name, the schedule and the message types of the node inside."""

    def __init__(self, node: Node) -> None:
        """Wrap a node."""
        self._node = node

    @property
    def name(self) -> str:
        """Name of the node inside."""
        return self._node.name

    @property
    def schedule(self) -> Schedule:
        """Schedule of the node inside."""
        return self._node.schedule

    @property
    def reads(self) -> tuple[type[Message], ...]:
        """Types that the node inside reads."""
        return self._node.reads

    @property
    def writes(self) -> tuple[type[Message], ...]:
        """Types that the node inside writes."""
        return self._node.writes
