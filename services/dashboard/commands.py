"""Commands of the page's buttons: each publishes one message; commands to the controller wait for its reply.

Each command opens its own session and closes it again, because buttons are pressed rarely.
"""

from __future__ import annotations

import enum
from typing import Annotated

import msgspec
from msgspec import Meta

from ltv_mpc.messages import Action, ClockCommand, Disturbance, Kill, Message
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import Session
from services.bus.topics import OPERATOR
from services.processes.operator import Outcome, on_bus, send_command

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
    """Execute a command and return its result, within twice the ``TIMEOUT_S`` of an operator.

    ``t_ns`` is the vehicle time, None if unknown; ``speed`` is the requested speed of the clock.
    """
    done, texts = on_bus(bus, lambda session: _outcome(request, session, t_ns, speed))
    return ButtonReply(number=request.number, done=done, text="; ".join(texts))


def _outcome(request: ButtonRequest, session: Session, t_ns: int | None, speed: float) -> Outcome:
    match request.button:
        case Button.ARM | Button.DISARM | Button.STOP | Button.HOLD | Button.CLEAR:
            done, texts = send_command(session, Action(request.button.value))
            return done, [f"{request.button.value}: {texts[0]}", *texts[1:]]
        case Button.PAUSE | Button.RESUME | Button.SPEED:
            asked = request.speed if request.button is Button.SPEED else speed
            what = f"{asked:g} x real time" if request.button is Button.SPEED else f"{request.button.value} the clock"
            command = ClockCommand(paused=request.button is Button.PAUSE, speed=asked)
            return _sent(session, command, f"requested: {what}")
        case Button.KILL:
            return _sent(session, Kill(node=request.node), f"requested: kill {request.node}")
        case Button.KICK if t_ns is not None:
            kick = Disturbance(end_t_ns=t_ns + round(KICK_S * 1e9), force_N=KICK_N)
            return _sent(session, kick, f"pushed east with {KICK_N[1]:g} N for {KICK_S:g} s")
        case Button.KICK:
            return False, ["no clock message and no estimate received yet: vehicle time is unknown"]
    raise AssertionError("the page itself handles it")


def _sent(session: Session, message: Message, text: str) -> Outcome:
    """Publish a message that has no acknowledgement; its effect shows on the page."""
    Outbox(session, node=OPERATOR, epoch=new_epoch(), kinds=(type(message),)).publish(message)
    return True, [text]
