"""Points along the path of a schedule, for checks of a mission."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from ltv_mpc.messages import Array
from ltv_mpc.references.schedule import DEPTH, EAST, NORTH, WAY

Mask: TypeAlias = npt.NDArray[np.bool_]

STEP_M = 0.25
"""Distance between two points."""

MAX_SAMPLES = 5000
"""Largest number of steps; a longer path has longer ones."""


class PathSamples(NamedTuple):
    """Points of a path; a place alone counts as two points."""

    points: Array  # (P, 2) north and east (m)
    at: Array  # (P,) distance from the first point (m)
    way: Array  # (P,) distance along the path, which does not count detours (m)
    depth: Array  # (P,) depth (m), NaN if it is unknown

    def length_where(self, holds: Mask) -> float:
        """Return the length of the path (m) on which a condition (P,) holds."""
        return float(self.way[-1]) / (len(self.way) - 1) * int(np.count_nonzero(holds))


def sample(table: Array) -> PathSamples:
    """Return points of a schedule's table at equal distances."""
    north, east = table[NORTH], table[EAST]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(north), np.diff(east)))])
    at = np.linspace(0.0, along[-1], min(max(math.ceil(along[-1] / STEP_M), 1), MAX_SAMPLES) + 1)
    points = np.column_stack([np.interp(at, along, north), np.interp(at, along, east)])
    return PathSamples(points, at, np.interp(at, along, table[WAY]), np.interp(at, along, table[DEPTH]))
