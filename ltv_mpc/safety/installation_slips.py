"""Slips of an installation: signs, axes and wiring that are not those of the interface, by what undoes them.

A cable in the wrong plug, a heading counted from east or a yaw rate of the other sign makes a vehicle spin or run away,
and no vehicle file explains its motion. Undone in the data, a slip explains it far better. Two measures tell this
(``motion_fit.py``): how well the heading follows the yaw rate and the position the velocity, which needs no model; and
how well the velocities follow the thrusts.

Each function undoes one slip, in place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import numpy as np

from ltv_mpc.messages import Array, Pair
from ltv_mpc.safety.motion_fit import (
    HEADING,
    NOISE,
    POSITION,
    PROFILE,
    SEGMENT,
    SEGMENT_S,
    SIZE,
    VELOCITY,
    YAW_RATE,
    MotionFit,
    Record,
    Segments,
    T,
)


def _swap_thrusters(record: Record) -> None:
    record.thrust[:, 1:] = record.thrust[:, [2, 1, 4, 3]]


def _scale_thrust(port: float, starboard: float, record: Record) -> None:
    record.thrust[:, 1:] *= [port, starboard, port, starboard]


def _set_heading(right: Callable[[Array], Array], record: Record) -> None:
    record.motion[:, HEADING] = right(record.motion[:, HEADING])


def _swap_axes(record: Record) -> None:
    for columns in (VELOCITY, POSITION, PROFILE):
        record.motion[:, columns] = record.motion[:, columns][:, ::-1].copy()


def _scale(columns: int | slice, factor: float, record: Record) -> None:
    record.motion[:, columns] *= factor


def _turn_to_earth(record: Record) -> None:
    motion = record.motion
    ahead, aside = motion[:, VELOCITY].T.copy()
    cos, sin = np.cos(motion[:, HEADING]), np.sin(motion[:, HEADING])
    motion[:, VELOCITY] = np.stack([cos * ahead - sin * aside, sin * ahead + cos * aside], axis=1)


Undo: TypeAlias = Callable[[Record], None]
"""Change of a record in place."""

OF_ESTIMATES: dict[str, Undo] = {
    "the yaw rate has the wrong sign": partial(_scale, YAW_RATE, -1.0),
    "the yaw rate is in degrees per second": partial(_scale, YAW_RATE, math.pi / 180.0),
    "the heading is counted from east, to the left": partial(_set_heading, lambda heading: 0.5 * math.pi - heading),
    "the heading is counted to the left": partial(_set_heading, np.negative),
    "the heading is in degrees": partial(_set_heading, np.radians),
    "the velocities are along the vehicle's axes": _turn_to_earth,
    "the velocities are in knots": partial(_scale, VELOCITY, 1852.0 / 3600.0),
}
"""Slips that contradict the estimates' own kinematics."""

OF_THRUSTS: dict[str, Undo] = {
    "port and starboard thruster are swapped": _swap_thrusters,
    "the port thruster is reversed": partial(_scale_thrust, -1.0, 1.0),
    "the starboard thruster is reversed": partial(_scale_thrust, 1.0, -1.0),
    "both thrusters are reversed": partial(_scale_thrust, -1.0, -1.0),
    "the heading is that of the stern": partial(_set_heading, lambda heading: heading + math.pi),
    "the heading is that of the port side": partial(_set_heading, lambda heading: heading + 0.5 * math.pi),
    "the heading is that of the starboard side": partial(_set_heading, lambda heading: heading - 0.5 * math.pi),
    "north and east are swapped": _swap_axes,
}
"""Slips that only the motion's answer to the thrusts shows."""

FOUND_NATS, FOUND_SHARE, AS_GOOD = 15.0, 0.1, 0.6
"""Evidence from which a slip is named: so many nats, and so many for each number that is explained. Right installations
reach 0.07, with hulls and files of another structure, noise and latency; slips from 0.13 (swapped thrusters of a
catamaran) to 5. And share of the largest evidence by kinematics from which a slip is as good as another.
"""


MOVES, ANSWERED = 4.0, 0.25
"""Variance of a motion over that of its noise from which it counts; and share of it that the thrusts may leave."""

FOLLOWS = np.array([0.05, 0.02, 0.02])
"""Least error of what the heading (rad) and the position change in a segment; of the position, over the way at the top
speed.
"""


class SlipTest:
    """Test of one slip of each kind after the other, while the motion gives a reason."""

    def __init__(self, fit: MotionFit) -> None:
        """Begin without a slip.

        Parameters
        ----------
        fit : of the motion.
        """
        self._fit, self._tests = fit, 0
        self._evidence: dict[str, Pair] = {}  # of the slips that are found (nats): by kinematics, by the model

    def update(self) -> None:
        """Test the next slip of each kind, and the one that is found again. Without a reason, none is found."""
        segments, found = self._fit.segments, self.found
        if segments is None:
            return
        for slips, reason in (
            (OF_ESTIMATES, not self._follows_rates(segments)),
            (OF_THRUSTS, not self._answers(segments)),
        ):
            names = list(slips)
            tested = {names[self._tests % len(names)], found} & set(names) if reason else set(names)
            for slip in tested:
                self._evidence.pop(slip, None)
                if reason:
                    self._test(slip, slips[slip], segments)
        self._tests += 1

    def _test(self, slip: str, undo: Undo, segments: Segments) -> None:
        least, undone = FOUND_NATS + FOUND_SHARE * 3.0 * float(segments.worth.sum()), _copy(self._fit.record)
        undo(undone)
        by_kinematics = self._by_kinematics(undone, segments) if slip in OF_ESTIMATES else 0.0
        if slip in OF_ESTIMATES and by_kinematics < least:
            return
        by_model = self._by_model(undone, segments)
        if by_kinematics + by_model > least:
            self._evidence[slip] = by_kinematics, by_model

    @property
    def found(self) -> str:
        """Slip that explains the motion far better than the interface does; empty if none does."""
        most = max((by_kinematics for by_kinematics, _ in self._evidence.values()), default=0.0)
        good = [slip for slip, (by_kinematics, _) in self._evidence.items() if by_kinematics >= AS_GOOD * most]
        return max(good, key=lambda slip: self._evidence[slip][1], default="")

    @property
    def _least_drift(self) -> Array:
        """Least variances (3,) of what heading (rad^2) and position (m^2) change in a segment."""
        way_m = SEGMENT_S * math.sqrt(self._fit.floor[0]) / NOISE
        variances: Array = (FOLLOWS * [1.0, way_m, way_m]) ** 2
        return variances

    def _answers(self, segments: Segments) -> bool:
        """Return True if the motion ahead and in yaw follows the thrusts, or there is none."""
        fit, given, without = self._fit, self._fit.record, _copy(self._fit.record)
        without.thrust[:, 1:] = 0.0
        left, moved = (segments.noise(fit.misfit(fit.x, of, segments), fit.floor)[::2, 0] for of in (given, without))
        return not ((moved > MOVES * fit.floor[::2]) & (left > ANSWERED * moved)).any()

    def _follows_rates(self, segments: Segments) -> bool:
        """Return True if heading and position follow yaw rate and velocity."""
        noise = segments.noise(_drift(self._fit.record.motion, segments), self._least_drift)
        return not (noise[:, 0] > MOVES * (self._least_drift + noise[:, -1])).any()

    def _by_model(self, undone: Record, segments: Segments) -> float:
        """Return by how much the least J is below that of the record as it is (nats)."""
        fit = self._fit

        def least(record: Record) -> float:
            x = np.zeros(SIZE)
            for _ in range(2):
                x, _ = fit.improved(x, record, segments)
            return fit.unlikely(x, record, segments)

        given = fit.record
        return 0.5 * (min(fit.unlikely(fit.x, given, segments), least(given)) - least(undone))

    def _by_kinematics(self, undone: Record, segments: Segments) -> float:
        """Return by how much better heading and position follow their rates (nats).

        What the record as it is lacks in the highest band is noise.
        """
        given, changed = (_drift(of.motion, segments) for of in (self._fit.record, undone))
        floor = self._least_drift + segments.noise(given, self._least_drift)[:, -1]
        return 0.5 * (segments.unlikely(given, floor) - segments.unlikely(changed, floor))


def _copy(record: Record) -> Record:
    return Record(record.motion.copy(), record.thrust.copy())


def _drift(motion: Array, segments: Segments) -> Array:
    """Return what heading and position change in a segment beyond the integrals of their rates (3, M)."""
    rates = np.column_stack([motion[:, YAW_RATE], motion[:, VELOCITY]])
    values = np.column_stack([np.unwrap(motion[:, HEADING]), motion[:, POSITION]])
    way = 0.5 * np.diff(motion[:, T])[:, None] * (rates[1:] + rates[:-1])
    drift = values - np.concatenate([np.zeros((1, 3)), way.cumsum(axis=0)])
    begins = np.flatnonzero(np.diff(motion[:, SEGMENT], prepend=-1.0))
    drift -= drift[begins].repeat(np.diff(begins, append=len(drift)), axis=0)
    D: Array = drift.T @ segments.cosines
    return D
