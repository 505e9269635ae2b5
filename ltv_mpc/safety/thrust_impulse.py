"""Impulse of the delivered thrusts of port and starboard, up to any time within the last seconds."""

from __future__ import annotations

import numpy as np

from ltv_mpc.jit import count_up_to, jit
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
        """Return a vehicle time on the time axis of the rows (s).

        Parameters
        ----------
        t_ns : vehicle time (ns).
        """
        return (t_ns - self._origin_ns) * 1e-9

    def add(self, t_ns: int, thrust_N: Triple | Array) -> None:
        """Add the thrusts at a time.

        Parameters
        ----------
        t_ns : vehicle time (ns). What is not newer than the last is ignored.
        thrust_N : of port, starboard and vertical (N).
        """
        rows = self.rows
        if not len(rows):
            self._origin_ns = t_ns
        t, port, starboard = self.seconds(t_ns), float(thrust_N[0]), float(thrust_N[1])
        row = [t, port, starboard, 0.0, 0.0]
        if len(rows):
            t0, port0, starboard0, *impulse = rows[-1].tolist()
            if t <= t0:
                return
            row[3] = impulse[0] + 0.5 * (t - t0) * (port0 + port)
            row[4] = impulse[1] + 0.5 * (t - t0) * (starboard0 + starboard)
            rows = rows[max(int(rows[:, 0].searchsorted(t - self._kept_s, "right")) - 1, 0) :]
        self.rows = np.concatenate([rows, [row]])

    def until(self, t_ns: int) -> Pair | None:
        """Return the impulses (N s) up to ``t_ns``; None before the oldest thrusts that are kept.

        Parameters
        ----------
        t_ns : time (ns).
        """
        t = self.seconds(t_ns)
        return impulses(self.rows, t) if len(self.rows) and t >= self.rows[0, 0] else None


@jit
def impulses(rows: Array, t: float) -> Pair:
    """Return the impulses (N s) of port and starboard up to a time.

    Parameters
    ----------
    rows : as in ``ThrustImpulse``, at least one.
    t : time (s), not before the first row.
    """
    k = count_up_to(rows[:, 0], t) - 1
    at, later = rows[k], rows[min(k + 1, len(rows) - 1)]
    s = t - at[0]
    half = 0.5 * s * s / (later[0] - at[0]) if later[0] > at[0] else 0.0
    return at[3] + s * at[1] + half * (later[1] - at[1]), at[4] + s * at[2] + half * (later[2] - at[2])
