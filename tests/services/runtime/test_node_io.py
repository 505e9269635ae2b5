"""Pending inbox: order of arrival, and what stays for a later step."""

from __future__ import annotations

from ltv_mpc.messages import InboxEntry, PressureDepth
from services.runtime.node_io import PendingInbox


def filled(*received_ns: int) -> PendingInbox:
    inbox = PendingInbox()
    for sequence, t_ns in enumerate(received_ns):
        entry = InboxEntry(key="sensor/depth", epoch=1, sequence=sequence, crc=0, received_t_ns=t_ns)
        inbox.add(PressureDepth(t_ns=0, depth_m=1.0), entry)
    return inbox


def taken(inbox: PendingInbox, until_ns: int | None = None) -> list[int]:
    messages, entries = inbox.take(until_ns)
    assert [message.sequence for message in messages] == [entry.sequence for entry in entries]
    return [entry.sequence for entry in entries]


def test_a_step_takes_what_arrived_until_its_time_and_the_next_one_the_rest() -> None:
    inbox = filled(10, 20, 30)
    assert taken(inbox, 20) == [0, 1]
    assert taken(inbox) == [2]
    assert taken(inbox) == []


def test_the_order_of_arrival_holds_even_if_the_clock_read_less_later() -> None:
    inbox = filled(10, 30, 20)
    assert taken(inbox, 20) == [0]
    assert taken(inbox) == [1, 2]
