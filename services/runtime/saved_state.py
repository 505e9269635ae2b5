"""Saved state of a node: what a new process of its name continues from."""

from __future__ import annotations

from typing import Protocol

from ltv_mpc.messages import Message
from services.bus.topics import STATES
from services.bus.wire import decode


class SavedState(Protocol):
    """Place in which the states that a node publishes survive its process."""

    failures: int
    """Number of states that could not be kept."""

    def restored(self, t_ns: int, now_us: int, *, own_clock: bool) -> Message | None:
        """Return the state that the node continues from, which becomes the first message of its first step.

        ``t_ns`` is the vehicle time of that step and ``now_us`` the monotonic time. ``own_clock``: vehicle time is this
        process's own monotonic time plus an offset, so both advance alike.
        """
        ...

    def keep(self, state: Message, now_us: int) -> None:
        """Keep a state that the node publishes at the monotonic time ``now_us``, before it is published."""
        ...


class SupervisorState:
    """State that the supervisor has given to this process; it receives the later ones from the bus."""

    def __init__(self, node: str, payload: bytes) -> None:
        """``payload`` is the encoded state; empty if there is none to continue from."""
        self.failures = 0
        self._state = decode(STATES[node], payload)[0] if payload else None

    def restored(self, t_ns: int, now_us: int, *, own_clock: bool) -> Message | None:
        """Return the state as it was given."""
        del t_ns, now_us, own_clock
        return self._state

    def keep(self, state: Message, now_us: int) -> None:
        """Leave it to the bus."""
