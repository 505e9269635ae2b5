"""Restarted node: it is dead in given intervals, and a new one then continues from the state that it published last."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec

from ltv_mpc.messages import ControllerState, Message, Plan
from ltv_mpc.node import Inbox, Node, ReceivedMessage
from sim.faults.interval import Interval
from sim.faults.node_wrapper import NodeWrapper


class RestartedNode(NodeWrapper):
    """Controller that dies at the start of each interval and is replaced at its end."""

    def __init__(self, make: Callable[[], Node], intervals: Sequence[Interval]) -> None:
        """Begin with the first node that ``make`` returns."""
        super().__init__(make())
        self._make = make
        self._intervals = intervals
        self._dead = False
        self._state: ControllerState | None = None
        self._plan: Plan | None = None  # in force

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        """Step the node inside; a dead one publishes nothing and loses its inbox."""
        if any(interval.contains(t_ns) for interval in self._intervals):
            self._dead = True
            return []
        if self._dead:
            self._node, self._dead = self._make(), False
            if self._state is not None:
                state = msgspec.structs.replace(self._state, plan=self._plan)
                inbox = [ReceivedMessage(state, 0, 0, t_ns), *inbox]
        outputs = self._node.step(t_ns, inbox)
        for message in outputs:
            if isinstance(message, ControllerState):
                self._state = message
            elif isinstance(message, Plan):
                self._plan = message
        return outputs
