"""Operator: publish a command and wait for the controller's answer, or publish heartbeats."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from ltv_mpc.messages import Acknowledgement, Action, Command, Heartbeat, RejectedFrame
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import BusError, Session, Stopped, open_session
from services.bus.topics import BY_TYPE, OPERATOR
from services.runtime.console import Console
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import DONE, FAILED, Say, StopRequest

TIMEOUT_S = 3.0
"""Longest wait for a router, and again for the answer. A control cycle takes a third of a second."""

Outcome: TypeAlias = tuple[bool, Sequence[str]]
"""Whether something was done, and what to say of it: first the result, then warnings."""

HEARTBEAT_S = BY_TYPE[Heartbeat].period_ns * 1e-9


def heartbeat(bus: BusOptions) -> int:
    """Publish a heartbeat once a second until a signal stops it. Return the exit code."""

    def work(request: StopRequest, say: Say) -> None:
        with open_session(bus, stop=request, say=say) as session:
            outbox = Outbox(session, node=OPERATOR, epoch=new_epoch(), kinds=(Heartbeat,))
            while not request.wait(HEARTBEAT_S):
                outbox.publish(Heartbeat())

    return run_until_stopped(Console("ctl heartbeat"), work)


def main(action: Action, fields: Mapping[str, Any], bus: BusOptions) -> int:
    """Send a command with its other fields.

    Returns 0 if the controller accepted it, else prints the reason to stderr and returns 1.
    """
    say = Console(f"ctl {action.value}").say
    done, (text, *warnings) = on_bus(bus, lambda session: send_command(session, action, **fields), say)
    if not done:
        say(text)
        return FAILED
    sys.stdout.write(f"{text}\n")
    for warning in warnings:
        say(warning)
    return DONE


def on_bus(bus: BusOptions, act: Callable[[Session], Outcome], say: Say = lambda _: None) -> Outcome:
    """Return the outcome of an act on a session of its own, or why the session cannot be opened in ``TIMEOUT_S``."""
    until = time.monotonic() + TIMEOUT_S
    try:
        with open_session(bus, stop=lambda: time.monotonic() > until, say=say) as session:
            return act(session)
    except Stopped:
        return False, [f"no router within {TIMEOUT_S:.0f} s"]
    except BusError as error:
        return False, [str(error)]


def send_command(session: Session, action: Action, **fields: Any) -> Outcome:
    """Send a command, and return the controller's answer."""
    box = Mailbox()
    for kind, suffix in ((Acknowledgement, ""), (RejectedFrame, "/*")):
        session.subscribe(f"{BY_TYPE[kind].key}{suffix}", BY_TYPE[kind], box)
    outbox = Outbox(session, node=OPERATOR, epoch=new_epoch(), kinds=(Command,))
    command = Command(command_id=new_epoch(), action=action, **fields)
    sent = outbox.publish(command)
    until = time.monotonic() + TIMEOUT_S
    while (left := until - time.monotonic()) > 0:
        frame = box.take(left)
        match frame and frame.decoded and frame.decoded[0]:
            case Acknowledgement(command_id=command.command_id) as answer:
                word = "accepted" if answer.accepted else f"rejected: {answer.why}"
                return answer.accepted, [f"{word}; command authority: {answer.authority.value}", *answer.warnings]
            case RejectedFrame(key=sent.key, crc=sent.crc) as answer:
                return False, [f"rejected by {answer.node}: {answer.reason}"]
    problem = f"no reply from a controller within {TIMEOUT_S:.0f} s: is one running at this router and namespace?"
    return False, [problem]
