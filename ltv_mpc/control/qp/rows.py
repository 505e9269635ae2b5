"""Names and units of the rows of the QP."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from ltv_mpc.messages import Array

SIDES = ("port", "starboard")
STATE_NAMES = ("north", "east", "surge", "sway", "heading", "yaw rate", "port's thrust", "starboard's thrust")
STATE_UNITS = ("m", "m", "m/s", "m/s", "rad", "rad/s", "N", "N")


class ConstraintRow(NamedTuple):
    """One row of A."""

    name: str  # "slew of port in stage 4"
    scale: float  # the row times this is in ``unit``
    unit: str


def dynamics(stages: Sequence[int], scale: Array) -> Iterator[ConstraintRow]:
    """Of the motion up to the end of each of these stages; ``scale`` (8,) of the states."""
    for k in stages:
        for name, unit, by in zip(STATE_NAMES, STATE_UNITS, scale.tolist(), strict=True):
            yield ConstraintRow(f"the motion ({name}) up to the end of stage {k}", by, unit)


def terminal_velocity() -> Iterator[ConstraintRow]:
    """Of the velocity over ground at the horizon's end."""
    for name in ("north", "east"):
        yield ConstraintRow(f"the velocity over ground ({name}) at the end", 1.0, "m/s")


def slew(stages: Sequence[int], scale: Array) -> Iterator[ConstraintRow]:
    """Of the change of both commands in each of these stages; ``scale`` (2,) of the thrusts."""
    for k in stages:
        for side, by in zip(SIDES, scale.tolist(), strict=True):
            yield ConstraintRow(f"slew of {side} in stage {k}", by, "N")


def motion(stages: Sequence[int], limited: Sequence[int], scale: Array) -> Iterator[ConstraintRow]:
    """Of the states ``limited`` at the end of each of these stages; ``scale`` of all states."""
    for k in stages:
        for i in limited:
            for of in ("upper limit of", "lower limit of", "excess of"):
                yield ConstraintRow(f"{of} {STATE_NAMES[i]} at the end of stage {k}", float(scale[i]), STATE_UNITS[i])


def box(stages: Sequence[int], scale: Array) -> Iterator[ConstraintRow]:
    """Of both commands at the end of each of these stages."""
    for k in stages:
        for side, by in zip(SIDES, scale.tolist(), strict=True):
            yield ConstraintRow(f"limit of {side} at the end of stage {k}", by, "N")
