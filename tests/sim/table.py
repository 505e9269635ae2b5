"""Nodes and plans small enough to write down by hand what lock step hands to whom."""

from __future__ import annotations

from typing import Any

import numpy as np

from ltv_mpc.messages import Message, Plan
from ltv_mpc.node import Inbox, Schedule
from tests.ltv_mpc.plans import plan_of

MS = 1_000_000


def plan(cycle_t_ns: int, estimate_t_ns: int) -> Plan:
    return plan_of(cycle_t_ns, np.zeros((3, 3)), estimate_t_ns=estimate_t_ns)


class Fake:
    """A node that answers with a function and keeps what it was handed."""

    def __init__(
        self,
        name: str,
        schedule: Schedule,
        reads: tuple[type[Message], ...] = (),
        answer: Any = None,
        writes: tuple[type[Message], ...] = (),
    ) -> None:
        self.name = name
        self.schedule = schedule
        self.reads = reads
        self.writes = writes
        self.answer = answer or (lambda _t_ns, _inbox: [])
        self.seen: list[tuple[int, list[tuple[type[Message], int, int]]]] = []

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        self.seen.append((t_ns, [(type(a.message), a.sequence, a.received_t_ns) for a in inbox]))
        return self.answer(t_ns, inbox)

    @property
    def times_ms(self) -> list[float]:
        return [t_ns / MS for t_ns, _ in self.seen]
