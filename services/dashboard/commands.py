"""Commands of the page's buttons: each publishes one message; commands to the controller wait for its reply.

Each command opens its own session and closes it again, because buttons are pressed rarely.
"""

from __future__ import annotations

import enum
import time
from collections.abc import Callable
from typing import Annotated

import msgspec
from msgspec import Meta

from ltv_mpc.messages import Acknowledgement, Action, ClockCommand, Disturbance, Kill, Message, RejectedFrame
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import BusError, Session, Stopped, open_session
from services.bus.topics import OPERATOR
from services.processes.operator import TIMEOUT_S, send_command

KICK_S = 2.0
KICK_N = (0.0, 120.0, 0.0)
"""Disturbance force on the vehicle (N, NED) for ``KICK_S`` of vehicle time: it moves it about 0.5 m to the east."""


class Button(enum.StrEnum):
    """Buttons of the page."""

    ARM = "arm"
    DISARM = "disarm"
    STOP = "stop"
    HOLD = "hold"
    CLEAR = "clear"
    PAUSE = "pause"
    RESUME = "resume"
    SPEED = "speed"
    KICK = "kick"
    KILL = "kill"
    HEARTBEAT = "heartbeat"  # not a button: a page with the token sends it once a second
    DRAWN = "drawn"  # not a button: a page sends it when it has drawn all plots once
    HAS_REPORT = "has report"  # the same, when it has its copy of the report


SIMULATED = frozenset((Button.PAUSE, Button.RESUME, Button.SPEED, Button.KICK, Button.KILL))
"""Buttons that work in a simulation only."""


class ButtonRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Command that the page sends. ``speed`` is for the button SPEED, ``node`` for KILL."""

    number: Annotated[int, Meta(ge=0, le=2**53 - 1)]  # repeated in the reply
    token: Annotated[str, Meta(max_length=100)]
    button: Button
    speed: Annotated[float, Meta(ge=0.01, le=1000.0)] = 1.0
    node: Annotated[str, Meta(max_length=40)] = ""


class ButtonReply(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="reply"):
    """Reply to a command of the page."""

    number: int
    done: bool
    text: str


def do(request: ButtonRequest, bus: BusOptions, t_ns: int | None, speed: float) -> ButtonReply:
    """Execute a command and return its result, within twice ``TIMEOUT_S``.

    ``t_ns`` is the vehicle time, None if unknown; ``speed`` is the requested speed of the clock.
    """
    try:
        with open_session(bus, stop=_patience(), say=lambda _: None) as session:
            return _done(request, session, t_ns, speed)
    except Stopped:
        return _reply(request, f"no router within {TIMEOUT_S:.0f} s")
    except BusError as error:
        return _reply(request, str(error))


def _done(request: ButtonRequest, session: Session, t_ns: int | None, speed: float) -> ButtonReply:
    match request.button:
        case Button.ARM | Button.DISARM | Button.STOP | Button.HOLD | Button.CLEAR:
            return _by_controller(request, send_command(session, Action(request.button.value)))
        case Button.PAUSE:
            return _sent(request, session, ClockCommand(paused=True, speed=speed), "requested: pause the clock")
        case Button.RESUME:
            return _sent(request, session, ClockCommand(paused=False, speed=speed), "requested: resume the clock")
        case Button.SPEED:
            text = f"requested: {request.speed:g} x real time"
            return _sent(request, session, ClockCommand(paused=False, speed=request.speed), text)
        case Button.KILL:
            return _sent(request, session, Kill(node=request.node), f"requested: kill {request.node}")
        case Button.HEARTBEAT | Button.DRAWN | Button.HAS_REPORT:
            raise AssertionError("the page itself handles them")
        case Button.KICK:
            if t_ns is None:
                return _reply(request, "no clock message and no estimate received yet: vehicle time is unknown")
            kick = Disturbance(end_t_ns=t_ns + round(KICK_S * 1e9), force_N=KICK_N)
            return _sent(request, session, kick, f"pushed east with {KICK_N[1]:g} N for {KICK_S:g} s")


def _by_controller(request: ButtonRequest, answer: Acknowledgement | RejectedFrame | None) -> ButtonReply:
    match answer:
        case Acknowledgement(accepted=True):
            text = f"{request.button.value} accepted; command authority: {answer.authority.value}"
            return _reply(request, "; ".join((text, *answer.warnings)), done=True)
        case Acknowledgement():
            return _reply(request, f"{request.button.value} rejected: {answer.why}")
        case RejectedFrame():
            return _reply(request, f"{request.button.value} rejected by {answer.node}: {answer.reason}")
        case None:
            return _reply(request, f"no reply from a controller within {TIMEOUT_S:.0f} s")


def _sent(request: ButtonRequest, session: Session, message: Message, text: str) -> ButtonReply:
    """Publish a message that has no acknowledgement; its effect shows on the page."""
    Outbox(session, node=OPERATOR, epoch=new_epoch(), kinds=(type(message),)).publish(message)
    return _reply(request, text, done=True)


def _reply(request: ButtonRequest, text: str, *, done: bool = False) -> ButtonReply:
    return ButtonReply(number=request.number, done=done, text=text)


def _patience() -> Callable[[], bool]:
    until = time.monotonic() + TIMEOUT_S
    return lambda: time.monotonic() > until
