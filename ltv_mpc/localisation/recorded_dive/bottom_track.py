"""Bottom track of a dive: its true path, the horizontal uniformity of the water, and the errors of the filter.

Truth   by dead reckoning; the filter under test does not receive this bottom track:
            p(t) = integral of v_b dt,  trapezoidal rule from ensemble to ensemble
        The velocity of an ensemble without bottom track is interpolated linearly in time. The truth is unknown across
        gaps longer than ``MAX_GAP_S``, and before the first and after the last ensemble with bottom track.
Uniformity  The filter's current depends on depth and time alone. Where it also changes along the track, beams show a
        change of the vehicle's velocity, and only bottom track separates the two. Of two ensembles k, l at one depth:
            c  = v_b + u,   u from the four beams of a cell                        current, north and east
            D  = mean over both axes of (c_k - c_l)^2 = n^2 + q_c^2 T + q_h^2 S + ...
        with T the time and S the distance run between them, n the noise (D of the tenth of the pairs with the shortest
        S), q_c the filter's change with time. q_h, the change with distance, is fitted by least squares. The water is
        called uniform unless the change q_h sqrt(S) over the whole track exceeds ``MAX_RATIO`` times the change
        q_c sqrt(T) that the filter expects.
Study   The filter runs from many starts. A window begins at one and ends at the first ensemble at least ``WINDOW_S``
        later. The filter is offered the bottom track of the first ``offered_fixes`` ensembles of the window; those of
        them that have bottom track are its fixes.
        The error e (2,) is the filter's displacement over the window minus that of bottom track, north and east. Inside
        3 sigma means e^T P^-1 e <= 9 with the covariance P of the filter's position (98.9 % of the errors of a
        consistent filter). Constant velocity, for comparison, is the mean bottom-track velocity of the fixes times the
        length of the window. The windows overlap, so the results of one dive are not independent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.recorded_dive.filter import Track, run
from ltv_mpc.localisation.recorded_dive.parameters import DiveParameters
from ltv_mpc.localisation.recorded_dive.recording import BeamNoise, usable
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


MAX_RATIO = 3.0
"""Largest change along the track in uniform water, relative to the change in time that the filter expects. Simulated
dives through uniform water reach 3; one with internal waves as well.
"""

MIN_PAIRS = 300
"""Smallest number of pairs for an answer."""

SHORT = 0.1
"""Share of the pairs, those with the shortest distance, that show the noise."""


class Uniformity(msgspec.Struct, frozen=True, kw_only=True):
    """Change of the current along the track."""

    change_mps_per_rtm: float  # q_h
    change_mps: float  # q_h sqrt(S) over the whole track
    run_m: float
    uniform: bool


def uniformity(ensembles: Sequence[BeamEnsemble], parameters: DiveParameters) -> Uniformity | None:
    """Return the change of the current along the track; None if too little of it has bottom track.

    Parameters
    ----------
    ensembles : the dive.
    parameters : ``water_change_mps_per_rts`` is the change that the filter expects.
    """
    path = dead_reckon(ensembles)
    steps_m = np.hypot(*path.velocity_mps[1:].T) * np.diff(path.t_s)
    run_m = np.concatenate([[0.0], np.nancumsum(steps_m)])
    number, depth_m, current_mps = _currents(ensembles, parameters.min_good_share)
    distance, time, square = [np.empty(0)], [np.empty(0)], [np.empty(0)]
    layers = np.round(depth_m / min(e.settings.cell_m for e in ensembles))
    for layer in np.unique(layers):
        here = np.flatnonzero(layers == layer)
        k, m = (here[index] for index in np.triu_indices(len(here), 1))
        distance.append(np.abs(run_m[number[k]] - run_m[number[m]]))
        time.append(np.abs(path.t_s[number[k]] - path.t_s[number[m]]))
        square.append(((current_mps[k] - current_mps[m]) ** 2).mean(axis=1))
    S, T, D = (np.concatenate(each) for each in (distance, time, square))
    if len(S) < MIN_PAIRS or not S.any():
        return None
    expected = parameters.water_change_mps_per_rts
    excess = D - D[np.quantile(S, SHORT) >= S].mean() - expected**2 * T
    q = math.sqrt(max(float(S @ excess) / float(S @ S), 0.0))
    change = q * math.sqrt(float(run_m[-1]))
    uniform = change <= MAX_RATIO * expected * math.sqrt(float(path.t_s[-1]))
    return Uniformity(change_mps_per_rtm=q, change_mps=change, run_m=float(run_m[-1]), uniform=uniform)


def _currents(ensembles: Sequence[BeamEnsemble], min_good_share: float) -> tuple[Array, Array, Array]:
    """Return the currents of all cells with four beams and bottom track: ensemble, depth (m), north and east (m/s)."""
    numbers, depths, currents = [np.empty(0, dtype=np.int64)], [np.empty(0)], [np.empty((0, 2))]
    for k, ensemble in enumerate(ensembles):
        if not np.isfinite(ensemble.bottom_mps[:2]).all():
            continue
        cells = usable(ensemble, min_good_share).all(axis=0)
        relative = np.linalg.lstsq(ensemble.direction, ensemble.velocity_mps[:, cells], rcond=None)[0]
        numbers.append(np.full(int(cells.sum()), k))
        depths.append(ensemble.depth_m + ensemble.below_m[:, cells].mean(axis=0))
        currents.append(relative[:2].T + ensemble.bottom_mps[:2])
    return np.concatenate(numbers), np.concatenate(depths), np.concatenate(currents)


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
    return StartResult(
        start=start,
        depth_m=ensembles[start].depth_m,
        after_s=duration_s,
        fixes=track.fixes,
        error_m=float(np.hypot(*error)),
        sigma_m=float(np.sqrt(np.linalg.eigvalsh(P)[-1])),
        inside_3_sigma=bool(error @ np.linalg.solve(P, error) <= 9.0),
        constant_velocity_error_m=(
            None if velocity is None else float(np.hypot(*(velocity * duration_s - true_displacement)))
        ),
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
