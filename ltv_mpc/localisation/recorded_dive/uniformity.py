"""Horizontal uniformity of the water in a recording, from bottom track: does the current change with the distance run?

The filter's current depends on depth and time alone. Where it also changes along the track, the beams show a change of
the vehicle's velocity, and only bottom track separates the two. Of two ensembles k, l that see one depth:

    c  = v_b + u,   u from the four beams of a cell                        current, north and east
    D  = mean over both axes of (c_k - c_l)^2 = n^2 + q_c^2 T + q_h^2 S + ...

with T the time and S the distance run between them, n the noise (D of the tenth of the pairs with the shortest S), q_c
the filter's change with time. q_h, the change with distance, is fitted by least squares. The water is called uniform
unless the change q_h sqrt(S) over the whole track exceeds ``MAX_RATIO`` times the change q_c sqrt(T) that the filter
expects.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.recorded_dive.parameters import DiveParameters
from ltv_mpc.localisation.recorded_dive.screening import usable
from ltv_mpc.localisation.recorded_dive.truth import dead_reckon
from ltv_mpc.messages import Array

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
    pairs = [np.empty((3, 0))]  # of each layer: distance, time, square of the difference
    layers = np.round(depth_m / min(e.settings.cell_m for e in ensembles))
    for layer in np.unique(layers):
        here = np.flatnonzero(layers == layer)
        k, m = (here[index] for index in np.triu_indices(len(here), 1))
        apart = (np.abs(of[number[k]] - of[number[m]]) for of in (run_m, path.t_s))
        pairs.append(np.array([*apart, ((current_mps[k] - current_mps[m]) ** 2).mean(axis=1)]))
    S, T, D = np.concatenate(pairs, axis=1)
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
