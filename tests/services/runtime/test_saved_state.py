"""Saved state of a node: it comes first in the first inbox, and is kept before anything after it is published."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import pytest

from ltv_mpc.messages import Acknowledgement, Authority, ControllerState, Estimate, InboxEntry, Message, StepRecord
from services.bus.outbox import Outbox
from services.bus.wire import Header, encode
from services.runtime.lifeline import LIFELINE
from services.runtime.node_io import NodeIO
from tests.services.bus.messages import CONTROLLER_STATE

STOPPED = ControllerState(t_ns=5, authority=Authority.STOPPED)
ACKNOWLEDGED = Acknowledgement(t_ns=5, command_id=1, accepted=True, authority=Authority.STOPPED, why="")


class Log(list[str]):
    """Order of what is kept and what is published; a session and a place of states at once."""

    failures = 0

    def publisher(self, key: str) -> SimpleNamespace:
        return SimpleNamespace(put=lambda _payload: self.append(f"published {key}"))

    def restored(self, t_ns: int, now_us: int, *, own_clock: bool) -> Message:
        self.append(f"restored at {t_ns}, {now_us}, {own_clock}")
        return CONTROLLER_STATE

    def keep(self, state: Message, now_us: int) -> None:
        assert now_us > 0
        assert isinstance(state, ControllerState)
        self.append(f"kept {state.authority.value}")


@pytest.fixture
def log() -> Log:
    return Log()


@pytest.fixture
def opened(log: Log) -> Callable[[], NodeIO]:
    kinds = (ControllerState, Acknowledgement)
    return lambda: NodeIO("controller", Outbox(log, node="controller", epoch=3, kinds=kinds), log)  # type: ignore[arg-type]


def test_a_state_is_kept_before_it_and_the_acknowledgement_are_published(opened, log) -> None:
    io = opened()
    for message in (STOPPED, ACKNOWLEDGED):
        io.publish(message)
    assert log == ["kept stopped", "published state/controller", "published acknowledged"]


def test_the_state_to_continue_from_comes_before_messages_that_have_waited(opened: Callable[[], NodeIO]) -> None:
    io = opened()
    io.add_to_inbox(Estimate.at_rest(), InboxEntry(key="estimate", epoch=1, sequence=0, crc=0, received_t_ns=1))
    io.restore_state(7, 8, own_clock=True)
    assert [type(arrival.message) for arrival in io.take_inbox(7, "cycle")] == [ControllerState, Estimate]


def test_the_supervisor_s_state_is_the_first_message_as_it_was_given(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = SimpleNamespace(publisher=lambda _: SimpleNamespace(put=lambda _: None))
    io = NodeIO("controller", Outbox(bus, node="controller", epoch=3, kinds=(ControllerState, StepRecord)))  # type: ignore[arg-type]
    io.restore_state(7, 8, own_clock=False)
    assert io.take_inbox(7, "cycle") == []  # it has given none
    given = encode(CONTROLLER_STATE, Header(epoch=0, sequence=0))
    monkeypatch.setattr(LIFELINE, "state", given)
    io.restore_state(7, 8, own_clock=False)
    (arrival,) = io.take_inbox(7, "cycle")
    assert encode(arrival.message, Header(epoch=0, sequence=0)) == given
