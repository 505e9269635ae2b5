"""Slips of an installation: signs, axes and wiring that are not those of the interface, by what undoes them.

A cable in the wrong plug or a heading counted from east makes a vehicle spin or run away, and no vehicle file explains
its motion. Undone in the data, a slip explains far better how the velocities follow the thrusts (``motion_fit.py``).
Velocities and yaw rates with a slip contradict positions and headings: that is seen sooner (``kinematic_filter.py``).

Each function undoes one slip, in place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import numpy as np

from ltv_mpc.messages import Array
from ltv_mpc.safety.motion_fit import HEADING, PROFILE, SIZE, VELOCITY, MotionFit, Record, Segments


def _swap_thrusters(record: Record) -> None:
    record.thrust[:, 1:] = record.thrust[:, [2, 1, 4, 3]]


def _scale_thrust(port: float, starboard: float, record: Record) -> None:
    record.thrust[:, 1:] *= [port, starboard, port, starboard]


def _set_heading(right: Callable[[Array], Array], record: Record) -> None:
    record.motion[:, HEADING] = right(record.motion[:, HEADING])


def _swap_axes(record: Record) -> None:
    for columns in (VELOCITY, PROFILE):
        record.motion[:, columns] = record.motion[:, columns][:, ::-1].copy()


Undo: TypeAlias = Callable[[Record], None]
"""Change of a record in place."""

SLIPS: dict[str, Undo] = {
    "the heading is counted from east, to the left": partial(_set_heading, lambda heading: 0.5 * math.pi - heading),
    "the heading is counted to the left": partial(_set_heading, np.negative),
    "the heading is in degrees": partial(_set_heading, np.radians),
    "port and starboard thruster are swapped": _swap_thrusters,
    "the port thruster is reversed": partial(_scale_thrust, -1.0, 1.0),
    "the starboard thruster is reversed": partial(_scale_thrust, 1.0, -1.0),
    "both thrusters are reversed": partial(_scale_thrust, -1.0, -1.0),
    "the heading is that of the stern": partial(_set_heading, lambda heading: heading + math.pi),
    "the heading is that of the port side": partial(_set_heading, lambda heading: heading + 0.5 * math.pi),
    "the heading is that of the starboard side": partial(_set_heading, lambda heading: heading - 0.5 * math.pi),
    "north and east are swapped": _swap_axes,
}

FOUND_NATS, FOUND_SHARE = 15.0, 0.1
"""Evidence from which a slip is named: so many nats, and so many for each number that is explained. Right installations
reach 0.07, with hulls and files of another structure, noise and latency; slips from 0.13 (swapped thrusters of a
catamaran) to 5.
"""

MOVES, ANSWERED = 4.0, 0.25
"""Variance of a motion over that of its noise from which it counts; and share of it that the thrusts may leave."""


class SlipTest:
    """Test of one slip after the other, while the motion gives a reason."""

    def __init__(self, fit: MotionFit) -> None:
        """Begin without a slip.

        Parameters
        ----------
        fit : of the motion.
        """
        self._fit, self._tests = fit, 0
        self._evidence: dict[str, float] = {}  # of the slips that are found (nats)

    def update(self) -> None:
        """Test the next slip, and the one that is found again. Without a reason, none is found."""
        segments, names = self._fit.segments, list(SLIPS)
        if segments is None:
            return
        if self._answers(segments):
            self._evidence.clear()
            return
        least = FOUND_NATS + FOUND_SHARE * 3.0 * float(segments.worth.sum())
        for slip in {names[self._tests % len(names)], self.found} & set(names):
            evidence = self._evidence_of(slip, segments)
            self._evidence.pop(slip, None)
            if evidence > least:
                self._evidence[slip] = evidence
        self._tests += 1

    @property
    def found(self) -> str:
        """Slip that explains the motion far better than the interface does; empty if none does."""
        return max(self._evidence, key=self._evidence.__getitem__, default="")

    def _answers(self, segments: Segments) -> bool:
        """Return True if the motion ahead and in yaw follows the thrusts, or there is none."""
        fit, given, without = self._fit, self._fit.record, _copy(self._fit.record)
        without.thrust[:, 1:] = 0.0
        left, moved = (segments.noise(fit.misfit(fit.x, of, segments), fit.floor)[::2, 0] for of in (given, without))
        return not ((moved > MOVES * fit.floor[::2]) & (left > ANSWERED * moved)).any()

    def _evidence_of(self, slip: str, segments: Segments) -> float:
        """Return by how much the least J of the record without a slip is below that of the record as it is (nats)."""
        fit, undone = self._fit, _copy(self._fit.record)
        SLIPS[slip](undone)

        def least(record: Record) -> float:
            x = np.zeros(SIZE)
            for _ in range(2):
                x, _ = fit.improved(x, record, segments)
            return fit.unlikely(x, record, segments)

        given = fit.record
        return 0.5 * (min(fit.unlikely(fit.x, given, segments), least(given)) - least(undone))


def _copy(record: Record) -> Record:
    return Record(record.motion.copy(), record.thrust.copy())
