"""Inputs and outputs of a node's steps: pending inbox, step records and outbox, under one epoch."""

from __future__ import annotations

from ltv_mpc.messages import Message, StepRecord
from ltv_mpc.node import ReceivedMessage
from services.bus.outbox import Outbox, SentFrame
from services.bus.wire import Header, crc
from services.runtime.inbox import PendingInbox


class NodeIO:
    """Inbox, records and outputs of one node, in the order that a replay needs.

    The record of a step is published before the outputs of the step. Records of steps without outputs wait for the next
    step that has outputs, or for the next node status, which follows within half a second.
    """

    def __init__(self, node: str, outbox: Outbox) -> None:
        self._node = node
        self._outbox = outbox
        self._inbox = PendingInbox()
        self._records: list[StepRecord] = []

    def publish(self, message: Message) -> SentFrame:
        """Publish a message of the process."""
        return self._outbox.publish(message)

    def deliver(self, message: Message, header: Header, *, key: str, payload: bytes, received_t_ns: int) -> None:
        """Put a received message into the inbox of the next step."""
        self._inbox.add(
            message,
            key=key,
            epoch=header.epoch,
            sequence=header.sequence,
            crc=crc(payload),
            received_t_ns=received_t_ns,
        )

    def publish_and_deliver(self, message: Message, now_ns: int) -> None:
        """Publish a message and put it into the node's own inbox, without the way through the bus."""
        sent = self._outbox.publish(message)
        self._inbox.add(
            message,
            key=sent.key,
            epoch=self._outbox.epoch,
            sequence=sent.sequence,
            crc=sent.crc,
            received_t_ns=now_ns,
        )

    def begin_step(self, step: int, t_ns: int, cause: str) -> list[ReceivedMessage]:
        """Return the inbox of a step and record the step. ``step`` counts from 0."""
        arrivals, entries = self._inbox.take()
        self._records.append(
            StepRecord(node=self._node, epoch=self._outbox.epoch, step=step, t_ns=t_ns, cause=cause, inbox=entries)
        )
        return arrivals

    def flush_records(self) -> None:
        """Publish the step records that wait."""
        for record in self._records:
            self._outbox.publish(record)
        self._records.clear()
