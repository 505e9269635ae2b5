"""One dive, many starts: the filter's error after a while against bottom track's, and against constant velocity's.

A start's window runs to the first ensemble 300 s or more after it. Of the window the filter gets the bottom track of
the first ``fixes`` ensembles; the error is the distance of its displacement from bottom track's.
Constant velocity is the mean of those fixes, held from the start.
Inside 3 sigma: e^T P^-1 e <= 9, e the error in the plane and P its covariance (98.9 % of a perfect filter's).
The windows overlap: a dive of ten minutes is one dive, however many starts are counted.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.recorded_dive.filter import Instrument, Track, run
from ltv_mpc.localisation.recorded_dive.parameters import DiveParameters
from ltv_mpc.localisation.recorded_dive.truth import BottomTrackPath
from ltv_mpc.messages import Array

WINDOW_S = 300.0
MIN_START_DEPTH_M, MAX_START_DEPTH_M = 2.0, 14.0
START_STRIDE = 2


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """One start."""

    start: int  # which of the dive's ensembles, from 0
    depth_m: float
    after_s: float
    fixes: int
    error_m: float
    sigma_m: float  # of the position, along its worst axis
    inside_3_sigma: bool
    constant_velocity_error_m: float | None  # None without a fix


def run_trial(
    ensembles: Sequence[BeamEnsemble],
    ground: BottomTrackPath,
    instrument: Instrument,
    parameters: DiveParameters,
    *,
    start: int,
    fixes: int,
) -> Trial | None:
    """From ensemble ``start``; None where the dive or its bottom track ends before the window does."""
    end = window_end(ground, start)
    if end is None or ground.displacement(start, end) is None:
        return None
    track = run(ensembles[start : end + 1], instrument, parameters, fixes=fixes)
    return evaluate_track(ensembles, ground, track, start=start, end=end, fixes=fixes)


def evaluate_track(
    ensembles: Sequence[BeamEnsemble], ground: BottomTrackPath, track: Track, *, start: int, end: int, fixes: int
) -> Trial | None:
    """``track``, which begins at ensemble ``start``, at ensemble ``end``. None without truth."""
    true = ground.displacement(start, end)
    held = constant_velocity(ensembles[start : start + fixes])
    if true is None:
        return None
    duration = float(ground.t_s[end] - ground.t_s[start])
    error = track.position_m[end - start] - true
    P = track.position_covariance[end - start]
    return Trial(
        start=start,
        depth_m=ensembles[start].depth_m,
        after_s=duration,
        fixes=track.fixes,
        error_m=float(np.hypot(*error)),
        sigma_m=float(np.sqrt(np.linalg.eigvalsh(P)[-1])),
        inside_3_sigma=bool(error @ np.linalg.solve(P, error) <= 9.0),
        constant_velocity_error_m=None if held is None else float(np.hypot(*(held * duration - true))),
    )


def constant_velocity(fixed: Sequence[BeamEnsemble]) -> Array | None:
    """Mean of the bottom track that there is, (2,)."""
    there = [e.bottom_mps[:2] for e in fixed if np.isfinite(e.bottom_mps[:2]).all()]
    return np.mean(there, axis=0) if there else None


def window_end(ground: BottomTrackPath, start: int) -> int | None:
    """The first ensemble ``WINDOW_S`` or more after ``start``."""
    end = int(np.searchsorted(ground.t_s, ground.t_s[start] + WINDOW_S))
    return end if end < len(ground.t_s) else None


def starts(ensembles: Sequence[BeamEnsemble]) -> list[int]:
    """Every second ensemble between 2 and 14 m."""
    return [k for k, e in enumerate(ensembles) if MIN_START_DEPTH_M <= e.depth_m <= MAX_START_DEPTH_M][::START_STRIDE]
