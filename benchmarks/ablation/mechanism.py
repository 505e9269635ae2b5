"""Mechanism that can be switched off, and the event that it exists for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import Any, NamedTuple, TypeAlias

Measures: TypeAlias = Mapping[str, float]
"""Measure -> its value in one run; NaN where it does not apply to that run (for example the delay of no detection)."""


class Event(NamedTuple):
    """A kind of run. Mechanisms that share an event share its runs with everything switched on."""

    name: str
    description: str
    run: Callable[[int], Measures]  # seed -> measures; a function of a module, so that it works in worker processes


class Mechanism(NamedTuple):
    """One row of the study. A mechanism with several events has a row for each."""

    name: str
    event: Event
    off: Callable[[], AbstractContextManager[Any]]  # while it is open, the mechanism is switched off in this process
    measures: tuple[str, ...]  # of those that the event returns: the ones to print
    timed: bool = False
    """Measure times: both runs of a pair are made one after the other in one process, in alternating order."""


@contextmanager
def replaced(*changes: tuple[object, str, object]) -> Iterator[None]:
    """Set attributes (owner, name, value) of modules or classes, and set them back afterwards."""
    missing = object()
    before = [(owner, name, vars(owner).get(name, missing)) for owner, name, _ in changes]
    for owner, name, value in changes:
        if not hasattr(owner, name):  # a switch that switches nothing must not go unnoticed
            raise AttributeError(f"{owner!r} has no {name!r}: the mechanism cannot be switched off there")
        setattr(owner, name, value)
    try:
        yield
    finally:
        for owner, name, value in before:
            if value is missing:
                delattr(owner, name)
            else:
                setattr(owner, name, value)
