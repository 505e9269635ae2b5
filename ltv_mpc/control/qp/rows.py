"""Names, scales and units of the rows of the QP, in the order of qp/sparse.py."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from ltv_mpc.messages import Array

SIDES = ("port", "starboard")
STATE_NAMES = ("north", "east", "surge", "sway", "heading", "yaw rate", "port's thrust", "starboard's thrust")
STATE_UNITS = ("m", "m", "m/s", "m/s", "rad", "rad/s", "N", "N")


class ConstraintRow(NamedTuple):
    """Name, scale and unit of one row of A."""

    name: str  # "slew of port in stage 4"
    scale: float  # the row times this has the unit ``unit``
    unit: str


def dynamics(stages: Sequence[int], scale: Array) -> Iterator[ConstraintRow]:
    """Yield the rows of the dynamics.

    Parameters
    ----------
    stages : numbers of the stages.
    scale : (8,) scales of the states.
    """
    for k in stages:
        for name, unit, factor in zip(STATE_NAMES, STATE_UNITS, scale.tolist(), strict=True):
            yield ConstraintRow(f"dynamics of {name} in stage {k}", factor, unit)


def terminal_velocity() -> Iterator[ConstraintRow]:
    """Yield the rows of the velocity over ground at the horizon's end."""
    for name in ("north", "east"):
        yield ConstraintRow(f"velocity over ground ({name}) at the end of the horizon", 1.0, "m/s")


def slew(stages: Sequence[int], scale: Array) -> Iterator[ConstraintRow]:
    """Yield the rows of the slew limits.

    Parameters
    ----------
    stages : numbers of the stages.
    scale : (2,) scales of the thrusts (N).
    """
    for k in stages:
        for side, factor in zip(SIDES, scale.tolist(), strict=True):
            yield ConstraintRow(f"slew of {side} in stage {k}", factor, "N")


def box(stages: Sequence[int], scale: Array) -> Iterator[ConstraintRow]:
    """Yield the rows of the box: the smallest and largest thrust.

    Parameters
    ----------
    stages : numbers of the stages.
    scale : (2,) scales of the thrusts (N).
    """
    for k in stages:
        for side, factor in zip(SIDES, scale.tolist(), strict=True):
            yield ConstraintRow(f"limit of {side} at the end of stage {k}", factor, "N")


def motion_limits(stages: Sequence[int], limited: Sequence[int], scale: Array) -> Iterator[ConstraintRow]:
    """Yield the rows of the soft limits of the motion.

    Parameters
    ----------
    stages : numbers of the stages.
    limited : indices of the states that have a limit.
    scale : (8,) scales of the states.
    """
    for k in stages:
        for i in limited:
            for kind in ("upper limit of", "lower limit of", "excess of"):
                yield ConstraintRow(f"{kind} {STATE_NAMES[i]} at the end of stage {k}", float(scale[i]), STATE_UNITS[i])


def half_planes(stages: Sequence[int], count: int, scale: float) -> Iterator[ConstraintRow]:
    """Yield the rows of the half-planes of the fence.

    Parameters
    ----------
    stages : numbers of the stages.
    count : half-planes of a stage.
    scale : scale of a position (m).
    """
    for k in stages:
        for j in range(count):
            for kind in ("half-plane", "excess of half-plane"):
                yield ConstraintRow(f"{kind} {j + 1} of the fence at the end of stage {k}", scale, "m")
