"""Loop of a process that runs an edge: frames of both sides in, the edge's outputs out, its status every 0.5 s.

The edge steps at its rate, and at once when a plan has come, so that thrusts do not wait for the next period.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import Protocol

from ltv_mpc.messages import NodeStatus, Plan
from services.bus.mailbox import Frame, Mailbox
from services.bus.message_validation import MessageValidator
from services.bus.outbox import Outbox
from services.bus.session import Session
from services.bus.topics import BY_TYPE, expression
from services.bus.wire import WireError
from services.edges.edge import Edge, Outgoing, Output, Received, Refused
from services.runtime.clock import monotonic_us
from services.runtime.console import tenfold
from services.runtime.stopping import Say, StopRequest

STATUS_US = 500_000


class Link(Protocol):
    """Connection to the other side. What it receives it offers to the mailbox of the loop, without a topic."""

    def send(self, frame: Outgoing) -> None:
        """Send a frame; one that cannot be sent is dropped."""
        ...


class EdgeLoop:
    """Loop of one edge between a session of this bus and a link."""

    def __init__(self, edge: Edge, session: Session, mailbox: Mailbox, epoch: int, say: Say) -> None:
        self._edge, self._mailbox, self._say = edge, mailbox, say
        self._outbox = Outbox(session, node=edge.name, epoch=epoch, kinds=(*edge.writes, NodeStatus))
        self._validator = MessageValidator()
        self._epoch = epoch
        self._reported, self._idle = 0, ""
        for kind in edge.reads:
            session.subscribe(expression(BY_TYPE[kind]), BY_TYPE[kind], mailbox)

    def run(self, link: Link, period_us: int, stop: StopRequest) -> None:
        """Run until a stop is requested. However it ends, the edge then releases the thrusters."""
        due_us = status_us = monotonic_us()
        try:
            while not stop():
                now_us = monotonic_us()
                if now_us >= due_us:
                    self._put(self._edge.step(now_us), link)
                    due_us = max(due_us + period_us, now_us)
                if now_us >= status_us:
                    self.publish_status()
                    status_us = now_us + STATUS_US
                if (frame := self._mailbox.take((min(due_us, status_us) - now_us) / 1e6)) is not None:
                    self._put(self._outputs(frame), link)
                    if frame.topic is BY_TYPE[Plan]:
                        due_us = now_us
        finally:
            for output in self._edge.release(monotonic_us()):
                with contextlib.suppress(Exception):  # one that cannot be sent must not keep back the others
                    self._put((output,), link)
            self.publish_status(finished=True)

    def _outputs(self, frame: Frame) -> Iterable[Output]:
        """Return what a frame of either side gives. One that raises is refused: no input ends the edge."""
        at_us = frame.received_monotonic_us
        try:
            if frame.topic is None:
                return self._edge.receive(Received(frame.key, frame.payload, frame.attachment, at_us))
            message, header = self._validator.validate(frame)
            if header.epoch != self._epoch:
                return tuple(self._edge.take(message, at_us, (header.epoch, header.sequence)))
        except WireError:  # counted by the validator
            pass
        except Refused as refusal:
            self._edge.refuse(refusal)
        except Exception as error:
            self._edge.refuse(Refused(f"{type(error).__name__} of {frame.key}: {error}"))
        return ()

    def _put(self, outputs: Iterable[Output], link: Link) -> None:
        for output in outputs:
            if isinstance(output, Outgoing):
                link.send(output)
            else:
                self._outbox.publish(output)

    def publish_status(self, *, finished: bool = False) -> None:
        """Publish the status of the edge; print why it does not drive, and the last reason at the 1st, 10th refusal."""
        edge = self._edge
        if edge.idle != self._idle:
            self._idle = edge.idle
            self._say(f"not driving: {edge.idle}" if edge.idle else "driving")
        if tenfold(edge.refused) > self._reported:
            self._reported = tenfold(edge.refused)
            self._say(f"refused, {edge.refused} so far: {edge.reason}")
        self._outbox.publish(
            NodeStatus(
                node=edge.name,
                t_ns=0,
                ready=True,
                waiting_for="" if finished else edge.waiting_for,
                steps=edge.accepted,
                published=self._outbox.published + 1,  # this one included
                received=edge.accepted + self._validator.received,
                dropped=edge.lost + self._validator.dropped + self._mailbox.overflowed,
                rejected=edge.refused + self._validator.rejected,
                finished=finished,
            )
        )
