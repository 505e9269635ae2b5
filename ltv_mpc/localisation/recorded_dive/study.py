"""Study of one dive from many starts: error of the filter against bottom track, compared with constant velocity.

A window begins at a start and ends at the first ensemble at least ``WINDOW_S`` later. The filter is offered the bottom
track of the first ``offered_fixes`` ensembles of the window; those of them that have bottom track are its fixes.

The error e (2,) is the filter's displacement over the window minus that of bottom track, north and east. Inside 3 sigma
means e^T P^-1 e <= 9 with the covariance P of the filter's position (98.9 % of the errors of a consistent filter).
Constant velocity, for comparison, is the mean bottom-track velocity of the fixes times the length of the window.

The windows overlap, so the results of one dive are not independent, however many starts there are.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.recorded_dive.filter import Track, run
from ltv_mpc.localisation.recorded_dive.noise import BeamNoise
from ltv_mpc.localisation.recorded_dive.parameters import DiveParameters
from ltv_mpc.localisation.recorded_dive.truth import BottomTrackPath
from ltv_mpc.messages import Array

WINDOW_S = 300.0
"""Smallest length of a window."""

MIN_START_DEPTH_M, MAX_START_DEPTH_M = 2.0, 14.0
"""Depths between which windows start."""

START_STRIDE = 2
"""Step from one start to the next, among the ensembles between the two depths."""


class StartResult(msgspec.Struct, frozen=True, kw_only=True):
    """Result of the window of one start."""

    start: int  # number of the ensemble in the dive, from 0
    depth_m: float
    after_s: float  # length of the window
    fixes: int  # ensembles whose bottom track the filter used
    error_m: float
    sigma_m: float  # standard deviation of the position along its worst axis
    inside_3_sigma: bool
    constant_velocity_error_m: float | None  # None without bottom track in the offered ensembles


def run_start(
    ensembles: Sequence[BeamEnsemble],
    bottom_track: BottomTrackPath,
    noise: BeamNoise,
    parameters: DiveParameters,
    *,
    start: int,
    offered_fixes: int,
) -> StartResult | None:
    """Run the filter over one window; return None if the dive ends before the window does, or without a truth.

    Parameters
    ----------
    ensembles : the dive.
    bottom_track : its bottom-track path.
    noise : beam noise of the recording.
    parameters : assumptions of the filter.
    start : first ensemble of the window.
    offered_fixes : number of first ensembles whose bottom track the filter receives.
    """
    end = window_end(bottom_track, start)
    if end is None or bottom_track.displacement(start, end) is None:
        return None
    track = run(ensembles[start : end + 1], noise, parameters, fixes=offered_fixes)
    return evaluate_track(ensembles, bottom_track, track, start=start, end=end, offered_fixes=offered_fixes)


def evaluate_track(
    ensembles: Sequence[BeamEnsemble],
    bottom_track: BottomTrackPath,
    track: Track,
    *,
    start: int,
    end: int,
    offered_fixes: int,
) -> StartResult | None:
    """Compare a track with bottom track; return None if the true displacement is unknown.

    Parameters
    ----------
    ensembles : the dive.
    bottom_track : its bottom-track path.
    track : estimated track that begins at ensemble ``start``.
    start, end : ensembles between which displacements are compared.
    offered_fixes : number of first ensembles whose bottom track the filter received.
    """
    true_displacement = bottom_track.displacement(start, end)
    velocity = constant_velocity(ensembles[start : start + offered_fixes])
    if true_displacement is None:
        return None
    duration_s = float(bottom_track.t_s[end] - bottom_track.t_s[start])
    error = track.position_m[end - start] - true_displacement
    P = track.position_covariance[end - start]
    constant = None if velocity is None else float(np.hypot(*(velocity * duration_s - true_displacement)))
    return StartResult(
        start=start,
        depth_m=ensembles[start].depth_m,
        after_s=duration_s,
        fixes=track.fixes,
        error_m=float(np.hypot(*error)),
        sigma_m=float(np.sqrt(np.linalg.eigvalsh(P)[-1])),
        inside_3_sigma=bool(error @ np.linalg.solve(P, error) <= 9.0),
        constant_velocity_error_m=constant,
    )


def constant_velocity(ensembles: Sequence[BeamEnsemble]) -> Array | None:
    """Return the mean bottom-track velocity (m/s, north and east), (2,); None if no ensemble has bottom track."""
    available = [e.bottom_mps[:2] for e in ensembles if np.isfinite(e.bottom_mps[:2]).all()]
    return np.mean(available, axis=0) if available else None


def window_end(bottom_track: BottomTrackPath, start: int) -> int | None:
    """Return the first ensemble at least ``WINDOW_S`` after ``start``, or None.

    Parameters
    ----------
    bottom_track : bottom-track path of the dive.
    start : first ensemble of the window.
    """
    end = int(np.searchsorted(bottom_track.t_s, bottom_track.t_s[start] + WINDOW_S))
    return end if end < len(bottom_track.t_s) else None


def starts(ensembles: Sequence[BeamEnsemble]) -> list[int]:
    """Return the starts: every ``START_STRIDE``-th of the ensembles between the two start depths."""
    return [k for k, e in enumerate(ensembles) if MIN_START_DEPTH_M <= e.depth_m <= MAX_START_DEPTH_M][::START_STRIDE]
