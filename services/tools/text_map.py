"""Map of a path and a fence as text, north up: what a file was read as."""

from __future__ import annotations

import numpy as np

from ltv_mpc.geofence.fence import Fence
from ltv_mpc.messages import Array
from ltv_mpc.references.schedule import EAST, NORTH, Schedule
from services.reporting.plots.fence import boundary

COLUMNS, ROWS = 72, 24
ASPECT = 2.0
"""Height of a letter over its width."""


def draw(schedule: Schedule | None, fence: Fence | None) -> str:
    """Return the map: B begin, E end, * path, + keep-in, # keep-out; empty if there is nothing to draw."""
    lines = [("+" if zone.keep_in else "#", boundary(zone)) for zone in (fence.zones() if fence else ())]
    if schedule is not None:
        way = schedule.table[[NORTH, EAST]].T
        lines += [("*", way), ("B", way[:1]), ("E", way[-1:])]
    if not lines:
        return ""
    places = np.concatenate([line for _, line in lines])
    low, extent = places.min(axis=0), np.ptp(places, axis=0)
    column_m = max(extent[1] / (COLUMNS - 1), extent[0] / (ROWS - 1) / ASPECT, 0.01)
    rows = int(extent[0] / column_m / ASPECT) + 1
    letters = np.full((rows, int(extent[1] / column_m) + 1), " ")
    for letter, line in lines:
        cells = np.rint((_dense(line, 0.5 * column_m) - low) / (column_m * ASPECT, column_m)).astype(np.int64)
        row, column = np.minimum(cells, np.array(letters.shape) - 1).T
        letters[rows - 1 - row, column] = letter
    keys = {"*": "B to E path", "+": "+ keep-in", "#": "# keep-out"}
    legend = [key for letter, key in keys.items() if letter in {letter for letter, _ in lines}]
    scale = f"north up, {extent[1]:.3g} m east by {extent[0]:.3g} m north, a letter is {column_m:.2g} m wide"
    return "\n".join([*("  " + "".join(row).rstrip() for row in letters), f"  {', '.join([*legend, scale])}"])


def _dense(line: Array, step_m: float) -> Array:
    """Return points (P, 2) along a line that are at most ``step_m`` apart."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    at = np.linspace(0.0, way[-1], int(way[-1] / step_m) + 2)
    return np.column_stack([np.interp(at, way, column) for column in line.T])
