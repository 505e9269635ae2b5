"""Where a dive went by bottom track: velocity over ground, added up. Truth for a filter that is not given it.

    p(t) = integral of v_b dt,  trapezoids from ensemble to ensemble

An ensemble without bottom track takes the velocity that lies linearly between its neighbours' in time. Where bottom
track is missing for longer than ``LONGEST_GAP_S`` there is no truth across the gap; nor before the first and after the
last ensemble that has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.messages import Array

LONGEST_GAP_S = 30.0


@dataclass(frozen=True, slots=True)
class BottomTrackPath:
    """Dead reckoning of all ensembles of a dive."""

    t_s: Array  # (N,), since the first ensemble
    velocity_mps: Array  # (N, 2), north and east; NaN outside the first and last bottom track
    _position_m: Array  # (N, 2), from an arbitrary place
    _broken: Array  # (N,), how many gaps too long lie before each ensemble

    def displacement(self, start: int, end: int) -> Array | None:
        """From ensemble ``start`` to ``end``, (2,), north and east; None where it is not known."""
        known = np.isfinite(self.velocity_mps[[start, end]]).all() and self._broken[start] == self._broken[end]
        return self._position_m[end] - self._position_m[start] if known else None


def dead_reckon(ensembles: Sequence[BeamEnsemble]) -> BottomTrackPath:
    """Of ensembles in their order."""
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
        late = np.flatnonzero(there)[1:][np.diff(t[there]) > LONGEST_GAP_S]
        broken = np.searchsorted(late, np.arange(len(t)), side="right").astype(np.float64)
        # within a gap that is too long nothing is known
        for end in late:
            start = np.flatnonzero(there[:end])[-1]
            v[start + 1 : end] = np.nan
    steps = 0.5 * (v[1:] + v[:-1]) * np.diff(t)[:, None]
    position = np.vstack([np.zeros((1, 2)), np.cumsum(np.nan_to_num(steps), axis=0)])
    return BottomTrackPath(t, v, position, broken)
