"""What a person sees of a run while it goes on: the newest message of each kind, and each process's word."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from ltv_mpc.messages import Applied, CycleTiming, Estimate, NodeStatus, Plan, Truth


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveView:
    """The run at one moment. Everything but the time is None or empty until it was heard."""

    t_ns: int  # vehicle time
    start_ns: int
    end_ns: int
    speed: float  # of the clock, times real time
    requested_speed: float  # more than that where the machine cannot keep up
    wall_s: float  # since the start of the run
    phase: str  # what the run does in one word: starting, afloat, diving, stopping
    truth: Truth | None = None
    estimate: Estimate | None = None
    plan: Plan | None = None
    applied: Applied | None = None
    timing: CycleTiming | None = None
    status: Mapping[str, NodeStatus] = field(default_factory=dict)  # by process
    state: Mapping[str, str] = field(default_factory=dict)  # by process: spawned, ready, running, ended, failed


class Screen(Protocol):
    """Whatever shows a run: fed about ten times a second from one thread, closed once."""

    def update(self, view: LiveView) -> None:
        """Show this moment."""
        ...

    def wait(self, what: str, share: float) -> None:
        """What is done before there is anything to show, and which share of it, 0 .. 1."""
        ...

    def say(self, text: str) -> None:
        """One line that stays: a phase, a loss, a restart."""
        ...

    def close(self) -> None:
        """Leave the terminal as it was."""
        ...
