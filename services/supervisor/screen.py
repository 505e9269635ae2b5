"""Interfaces of a run's screen and live page, and the view that the screen shows: newest messages, process states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from ltv_mpc.messages import (
    Applied,
    ControllerStatus,
    CycleTiming,
    Estimate,
    LocalisationReport,
    NodeStatus,
    Plan,
    Truth,
)
from services.bus.options import BusOptions

T = TypeVar("T")

ORDER = ("router", "plant", "sensors", "estimator", "controller", "recorder")
"""Processes of a run in the order of the data; others follow by name."""


def in_order(by_process: Mapping[str, T]) -> list[tuple[str, T]]:
    """Return the items in the order in which screen and page show the processes."""
    place = {name: i for i, name in enumerate(ORDER)}
    return sorted(by_process.items(), key=lambda item: (place.get(item[0], len(ORDER)), item[0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveView:
    """State of a run at one moment. Everything but the time is None or empty until the first message has arrived."""

    t_ns: int  # vehicle time
    start_ns: int
    end_ns: int | None  # None: a vehicle, whose end is not planned
    speed: float  # of the clock, as a multiple of real time
    requested_speed: float  # greater than ``speed`` if the machine cannot keep up
    wall_s: float  # since the start of the run
    phase: str  # starting, afloat, diving, paused, stopping; empty without a clock message
    truth: Truth | None = None
    estimate: Estimate | None = None
    localisation: LocalisationReport | None = None  # of this project's estimator
    plan: Plan | None = None
    applied: Applied | None = None
    controller: ControllerStatus | None = None
    timing: CycleTiming | None = None
    status: Mapping[str, NodeStatus] = field(default_factory=dict)  # by process
    state: Mapping[str, str] = field(default_factory=dict)  # by process: spawned, ready, running, ended, failed


class Screen(Protocol):
    """Display of a run: updated about ten times a second from one thread, closed once."""

    def update(self, view: LiveView) -> None:
        """Show this moment."""
        ...

    def wait(self, what: str, share: float) -> None:
        """Show the progress of a preparation, 0 to 1, before the run has started."""
        ...

    def say(self, text: str) -> None:
        """Print one line that stays: a phase, a loss, a restart."""
        ...

    def close(self) -> None:
        """Leave the terminal as it was."""
        ...


class LivePage(Protocol):
    """Page that shows a run in a browser, served by a process of its own."""

    def start(self, bus: BusOptions) -> None:
        """Start to serve the page. Its process waits for the router of ``bus``."""
        ...

    def show(self, preparation: str) -> None:
        """Show what is being prepared, until the page has data."""
        ...

    @property
    def awaited(self) -> bool:
        """True while a browser has opened the page but not drawn it: the clock then waits for it."""
        ...
