"""Study of one dive from many starts: error of the filter against bottom track, compared with constant velocity.

The window of a start runs to the first ensemble 300 s or more after it. In the window the filter receives the bottom
track of the first ``fixes`` ensembles; its error is the distance between its displacement and that of bottom track.
Constant velocity is the mean velocity of those fixes, held from the start.
Inside 3 sigma: e^T P^-1 e <= 9, with the horizontal error e and its covariance P (98.9 % of a perfect filter's).
The windows overlap: a dive of ten minutes remains one dive, however many starts are counted.
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
"""Smallest length of a window."""

MIN_START_DEPTH_M, MAX_START_DEPTH_M = 2.0, 14.0
"""Depths between which windows start."""

START_STRIDE = 2
"""Ensembles from one start to the next."""


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one start."""

    start: int  # number of the ensemble in the dive, from 0
    depth_m: float
    after_s: float
    fixes: int
    error_m: float
    sigma_m: float  # standard deviation of the position along its worst axis
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
    """Run the filter over one window; return None if the dive or its bottom track ends before the window.

    Parameters
    ----------
    ensembles : the dive.
    ground : its bottom-track path.
    instrument : settings and beam noise.
    parameters : assumptions of the filter.
    start : first ensemble of the window.
    fixes : number of first ensembles whose bottom track the filter receives.
    """
    end = window_end(ground, start)
    if end is None or ground.displacement(start, end) is None:
        return None
    track = run(ensembles[start : end + 1], instrument, parameters, fixes=fixes)
    return evaluate_track(ensembles, ground, track, start=start, end=end, fixes=fixes)


def evaluate_track(
    ensembles: Sequence[BeamEnsemble], ground: BottomTrackPath, track: Track, *, start: int, end: int, fixes: int
) -> Trial | None:
    """Compare a track with bottom track; return None if the true displacement is unknown.

    Parameters
    ----------
    ensembles : the dive.
    ground : its bottom-track path.
    track : estimated track that begins at ensemble ``start``.
    start, end : ensembles between which displacements are compared.
    fixes : number of first ensembles whose bottom track the filter received.
    """
    true = ground.displacement(start, end)
    constant = constant_velocity(ensembles[start : start + fixes])
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
        constant_velocity_error_m=None if constant is None else float(np.hypot(*(constant * duration - true))),
    )


def constant_velocity(fixed: Sequence[BeamEnsemble]) -> Array | None:
    """Return the mean velocity of the available bottom track (m/s), (2,), or None."""
    there = [e.bottom_mps[:2] for e in fixed if np.isfinite(e.bottom_mps[:2]).all()]
    return np.mean(there, axis=0) if there else None


def window_end(ground: BottomTrackPath, start: int) -> int | None:
    """Return the first ensemble at least ``WINDOW_S`` after ``start``, or None.

    Parameters
    ----------
    ground : bottom-track path of the dive.
    start : first ensemble of the window.
    """
    end = int(np.searchsorted(ground.t_s, ground.t_s[start] + WINDOW_S))
    return end if end < len(ground.t_s) else None


def starts(ensembles: Sequence[BeamEnsemble]) -> list[int]:
    """Return the starts: every second ensemble between 2 and 14 m of depth."""
    return [k for k, e in enumerate(ensembles) if MIN_START_DEPTH_M <= e.depth_m <= MAX_START_DEPTH_M][::START_STRIDE]
