"""True path of a dive from bottom track, by dead reckoning; the filter under test does not receive this bottom track.

    p(t) = integral of v_b dt,  trapezoidal rule from ensemble to ensemble

The velocity of an ensemble without bottom track is interpolated linearly in time. The truth is unknown across gaps
longer than ``MAX_GAP_S``, and before the first and after the last ensemble with bottom track.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.messages import Array

MAX_GAP_S = 30.0
"""Longest gap of bottom track across which the velocity is interpolated (s)."""


@dataclass(frozen=True, slots=True)
class BottomTrackPath:
    """Path of a dive by dead reckoning from bottom track."""

    t_s: Array  # (N,), since the first ensemble
    velocity_mps: Array  # (N, 2), north and east; NaN outside the first and last bottom track
    _position_m: Array  # (N, 2), from an arbitrary origin
    _broken: Array  # (N,), number of too long gaps before each ensemble

    def displacement(self, start: int, end: int) -> Array | None:
        """Return the displacement between two ensembles (m, north and east), (2,), or None if it is unknown.

        Parameters
        ----------
        start, end : ensembles.
        """
        known = np.isfinite(self.velocity_mps[[start, end]]).all() and self._broken[start] == self._broken[end]
        return self._position_m[end] - self._position_m[start] if known else None


def dead_reckon(ensembles: Sequence[BeamEnsemble]) -> BottomTrackPath:
    """Integrate the bottom-track velocity of ensembles in order of time."""
    t = 1e-9 * np.array([e.t_ns - ensembles[0].t_ns for e in ensembles], dtype=np.float64)
    measured = np.array([e.bottom_mps[:2] for e in ensembles])
    there = np.isfinite(measured).all(axis=1)
    v = np.full_like(measured, np.nan)
    broken = np.zeros(len(t))
    if there.any():
        first, last = np.flatnonzero(there)[[0, -1]]
        inside = slice(first, last + 1)
        for axis in range(2):
            v[inside, axis] = np.interp(t[inside], t[there], measured[there, axis])
        late = np.flatnonzero(there)[1:][np.diff(t[there]) > MAX_GAP_S]
        broken = np.searchsorted(late, np.arange(len(t)), side="right").astype(np.float64)
        # the velocity within a too long gap is unknown
        for end in late:
            start = np.flatnonzero(there[:end])[-1]
            v[start + 1 : end] = np.nan
    steps = 0.5 * (v[1:] + v[:-1]) * np.diff(t)[:, None]
    position = np.vstack([np.zeros((1, 2)), np.cumsum(np.nan_to_num(steps), axis=0)])
    return BottomTrackPath(t, v, position, broken)
