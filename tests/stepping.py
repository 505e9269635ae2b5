"""Nodes one step at a time, for tests that give a node its inbox by hand."""

from __future__ import annotations

from collections.abc import Sequence

from ltv_mpc.messages import Message
from ltv_mpc.node import Due, Inbox, Node


def step(node: Node, t_ns: int, inbox: Inbox) -> list[Message]:
    """Do one step of the node."""
    (outputs,) = node.steps([(t_ns, inbox)])
    return outputs


def feed_each(node: Node, due: Sequence[Due], at_once: int = 50) -> list[list[Message]]:
    """Do many steps in batches, and return the output of each.

    They give the same bits as single steps (test_lookahead), in less time.
    """
    batches = (due[first : first + at_once] for first in range(0, len(due), at_once))
    return [outputs for batch in batches for outputs in node.steps(batch)]


def feed(node: Node, due: Sequence[Due]) -> list[Message]:
    """Do many steps in batches, and return the output of all."""
    return [message for outputs in feed_each(node, due) for message in outputs]


class OneByOne:
    """A node whose class says what one step does."""

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        """Return what one step publishes."""
        raise NotImplementedError

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """Do these steps in turn."""
        return [list(self.step(t_ns, inbox)) for t_ns, inbox in due]
