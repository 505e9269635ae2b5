"""Impulse of the delivered thrusts of port and starboard, up to any time within the last seconds."""

from __future__ import annotations

import numpy as np

from ltv_mpc.messages import Array, Pair, Triple

KEPT_S = 5.0
"""Age up to which thrusts are kept. An estimate that arrives later than this is not compared with the model."""


class ThrustImpulse:
    """Integral of the delivered thrusts of port and starboard over time: linear between two, constant after the last.

    Parameters
    ----------
    kept_s : age (s) up to which thrusts are kept.
    """

    def __init__(self, kept_s: float = KEPT_S) -> None:
        self._kept_s, self._origin_ns = kept_s, 0
        self.rows = np.empty((0, 5))
        """Time (s), thrusts of port and starboard (N), and their impulses up to that time (N s)."""

    def seconds(self, t_ns: int) -> float:
        """Return a vehicle time (ns) on the time axis of the rows (s)."""
        return (t_ns - self._origin_ns) * 1e-9

    def add(self, t_ns: int, thrust_N: Triple | Array) -> None:
        """Add the thrusts at a time.

        Parameters
        ----------
        t_ns : vehicle time (ns). What is not newer than the last is ignored.
        thrust_N : of port, starboard and vertical (N).
        """
        if not len(self.rows):
            self._origin_ns = t_ns
        t, row, rows = self.seconds(t_ns), np.zeros((1, 5)), self.rows
        row[0, :3] = t, thrust_N[0], thrust_N[1]
        if len(rows):
            if t <= rows[-1, 0]:
                return
            row[0, 3:] = rows[-1, 3:] + 0.5 * (t - rows[-1, 0]) * (rows[-1, 1:3] + row[0, 1:3])
            rows = rows[max(int(np.searchsorted(rows[:, 0], t - self._kept_s, side="right")) - 1, 0) :]
        self.rows = np.concatenate([rows, row])

    def until(self, t_ns: int) -> Pair | None:
        """Return the impulses (N s) up to ``t_ns``; None before the oldest thrusts that are kept.

        Parameters
        ----------
        t_ns : time (ns).
        """
        t, rows = self.seconds(t_ns), self.rows
        k = int(np.searchsorted(rows[:, 0], t, side="right")) - 1
        if k < 0:
            return None
        at, later = rows[k], rows[min(k + 1, len(rows) - 1)]
        s = t - at[0]
        slope = (later[1:3] - at[1:3]) / max(later[0] - at[0], 1e-9)
        port, starboard = (at[3:] + s * at[1:3] + 0.5 * s * s * slope).tolist()
        return port, starboard
