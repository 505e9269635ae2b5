"""Ports of a process: the message types that it publishes and subscribes to, for its node and for the runtime."""

from __future__ import annotations

from collections.abc import Iterable

from ltv_mpc.messages import (
    Clock,
    ClockCommand,
    ClockStep,
    CycleTiming,
    Message,
    NodeStatus,
    RejectedFrame,
    RunEvent,
    StepRecord,
)
from ltv_mpc.node import Cycle, Node
from services.bus.mailbox import Mailbox
from services.bus.session import Session
from services.bus.topics import BY_TYPE, NAMED, expression

DELIVERED_BY_PROCESS: tuple[type[Message], ...] = (RejectedFrame, Clock)
"""Types that each process delivers to its own node, although others publish them too."""

CLOCK_MASTER_INPUTS: tuple[type[Message], ...] = (NodeStatus, ClockCommand)
"""Types that the clock master's process reads for its clock."""


def times_cycles(node: Node) -> bool:
    """Return True if the runtime measures each cycle and delivers the timing to the node's next cycle."""
    return isinstance(node.schedule, Cycle) and CycleTiming in node.reads


def inputs(node: Node) -> list[type[Message]]:
    """Return the inputs from other processes. The node's own messages are delivered without the bus."""
    return [kind for kind in node.reads if BY_TYPE[kind].written_by != node.name and kind not in DELIVERED_BY_PROCESS]


def outputs(node: Node, *, clock_master: bool) -> list[type[Message]]:
    """Return the types that the process publishes."""
    kinds: list[type[Message]] = [*node.writes, StepRecord, NodeStatus, RejectedFrame, RunEvent]
    if times_cycles(node):
        kinds.append(CycleTiming)
    if ClockStep in node.reads:
        kinds.append(ClockStep)
    if clock_master:
        kinds.append(Clock)
    return kinds


def subscribe(session: Session, kinds: Iterable[type[Message]], mailbox: Mailbox) -> None:
    """Subscribe to all types with one mailbox, so that arrivals have one order."""
    for kind in dict.fromkeys(kinds):
        topic = BY_TYPE[kind]
        session.subscribe(expression(topic), None if kind in NAMED else topic, mailbox)
