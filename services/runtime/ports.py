"""What a node's process publishes and subscribes to: the node's own ports, and those that every process has."""

from __future__ import annotations

from collections.abc import Iterable

from ltv_mpc.messages import Clock, CycleTiming, Message, NodeStatus, RejectedFrame, RunEvent, StepRecord
from ltv_mpc.node import Cycle, Node
from services.bus.mailbox import Mailbox
from services.bus.session import Session
from services.bus.topics import BY_TYPE


def times_cycles(node: Node) -> bool:
    """Whether its caller measures each cycle, and tells the node with the next one."""
    return isinstance(node.schedule, Cycle) and CycleTiming in node.reads


def inputs(node: Node) -> list[type[Message]]:
    """What comes from other processes; its own words it is handed without the bus."""
    own = (RejectedFrame, Clock)
    return [kind for kind in node.reads if BY_TYPE[kind].written_by != node.name and kind not in own]


def outputs(node: Node, *, clock_master: bool) -> list[type[Message]]:
    """What its process publishes."""
    kinds: list[type[Message]] = [*node.writes, StepRecord, NodeStatus, RejectedFrame, RunEvent]
    if times_cycles(node):
        kinds.append(CycleTiming)
    if clock_master:
        kinds.append(Clock)
    return kinds


def subscribe(session: Session, kinds: Iterable[type[Message]], mailbox: Mailbox) -> None:
    """All of them into one mailbox: arrival has one order."""
    for kind in dict.fromkeys(kinds):
        topic = BY_TYPE[kind]
        session.subscribe(f"{topic.key}/*" if topic.written_by == "*" else topic.key, topic, mailbox)
