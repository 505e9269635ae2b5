"""Nodes that a test gives their inboxes by hand, and the inertial samples in the messages of several."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ltv_mpc.messages import ImuSample, ImuSamples, Message
from ltv_mpc.node import Inbox, Node


def feed_each(node: Node, due: Iterable[tuple[int, Inbox]]) -> list[Sequence[Message]]:
    """Do many steps, and return the output of each."""
    return [node.step(t_ns, inbox) for t_ns, inbox in due]


def feed(node: Node, due: Iterable[tuple[int, Inbox]]) -> list[Message]:
    """Do many steps, and return the output of all."""
    return [message for outputs in feed_each(node, due) for message in outputs]


def as_sent(message: Message) -> Message:
    """Return the message as it travels: an inertial sample alone in its message, every other one as it is."""
    return ImuSamples(samples=(message,)) if isinstance(message, ImuSample) else message


def unpacked(messages: Iterable[Message]) -> list[Message]:
    """Return the messages with each inertial sample by itself."""
    parts = (message.samples if isinstance(message, ImuSamples) else (message,) for message in messages)
    return [part for several in parts for part in several]
