"""Kalman filter of a recorded dive: ADCP beams and, for the first ensembles, bottom track; no IMU.

Attitude and depth come from the instrument and are taken as exact. So the problem is linear (``model.py``).
In water that is not uniform (``uniformity.py``) the position error after the last fix has the additional variance, in
each axis,
    q_h^2 integral of (t_end - t)^2 |v| dt
because each change of the current with the distance run is taken for one of the vehicle's velocity from then on.

How fast the vehicle turns and accelerates follows from its beams. A glider changes its velocity by centimetres per
second from ensemble to ensemble, a vehicle that turns by metres, and between two turns hardly. So the random walk of
the filter has an intensity of its own in each step. With u the velocity relative to the water in an ensemble, the
median over its cells,

    q_k^2 = (|u_k - u_(k-1)|^2 / 2 - s_k^2 - s_(k-1)^2) / dt,   s^2 the variance of the noise of u in one axis

The median of n cells has pi / 2 times the variance of their mean. No error of a position enters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.recorded_dive.model import POSITION, VELOCITY, Model, beams, correct, over_ground
from ltv_mpc.localisation.recorded_dive.noise import BeamNoise
from ltv_mpc.localisation.recorded_dive.parameters import DiveParameters
from ltv_mpc.localisation.recorded_dive.screening import Mask, usable
from ltv_mpc.messages import Array


def velocity_changes(
    ensembles: Sequence[BeamEnsemble], masks: Sequence[Mask], noise: BeamNoise, least_mps_per_rts: float
) -> Array:
    """Return the intensity (N,) of the velocity's random walk (m/s per square root of s) in the step to each ensemble.

    Parameters
    ----------
    ensembles : the dive.
    masks : usable cells (4, cells) of each ensemble.
    noise : beam noise of the recording.
    least_mps_per_rts : smallest intensity.
    """
    changes = np.full(len(ensembles), least_mps_per_rts)
    before: tuple[int, Array, float] | None = None
    for k, (ensemble, mask) in enumerate(zip(ensembles, masks, strict=True)):
        cells = mask.all(axis=0)
        if not cells.any():
            continue
        inverse = np.linalg.pinv(ensemble.direction)[:2]
        through_water = np.median(inverse @ ensemble.velocity_mps[:, cells], axis=1)
        of_beam = float(np.mean(noise.sd_mps(ensemble.settings)[cells] ** 2))
        variance = 0.5 * math.pi * of_beam * 0.5 * float((inverse**2).sum()) / int(cells.sum())
        if before is not None:
            last, velocity, noise_before = before
            dt = 1e-9 * (ensemble.t_ns - ensembles[last].t_ns)
            square = float(((through_water - velocity) ** 2).sum()) / 2.0 - variance - noise_before
            changes[last + 1 : k + 1] = np.maximum(changes[last + 1 : k + 1], math.sqrt(max(square, 0.0) / dt))
        before = k, through_water, variance
    return changes


MAX_GRID_POINTS = 200
"""Largest number of grid points of the current, which bounds the time of a run."""


MAX_RANGES = 40
"""Largest number of ranges with a bias of their own in each beam."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """Estimated track of N ensembles: position relative to the first and velocity over ground, north and east."""

    t_ns: tuple[int, ...]
    position_m: Array  # (N, 2)
    position_covariance: Array  # (N, 2, 2)
    velocity_mps: Array  # (N, 2)
    fixes: int  # ensembles whose bottom track was used
    cells_used: int
    cells_screened: int  # cells with too few good pings or too near the bottom
    cells_rejected: int  # rejected by the gate
    nis: float  # residual^2 / S of the beams' rows before the gate: their median over that of a consistent filter
    water: WaterPrior

    @property
    def t_s(self) -> Array:
        """Time since the first ensemble (s), (N,)."""
        return 1e-9 * np.array([t - self.t_ns[0] for t in self.t_ns], dtype=np.float64)


def run(ensembles: Sequence[BeamEnsemble], noise: BeamNoise, parameters: DiveParameters, *, fixes: int) -> Track:
    """Estimate the track of a dive.

    Parameters
    ----------
    ensembles : the dive, in order of time.
    noise : beam noise of the recording.
    parameters : assumptions of the filter.
    fixes : number of first ensembles whose bottom track is used if available.

    Returns
    -------
    Track from the first ensemble on.
    """
    masks = [usable(x, parameters.min_good_share) for x in ensembles]
    model = Model.of(parameters, _nodes(ensembles, masks), _ranges(ensembles, masks))
    gate = float(chi2.ppf(parameters.gate_probability, 1))
    changes = velocity_changes(ensembles, masks, noise, parameters.velocity_change_mps_per_rts)
    x, P = model.prior()
    states = []
    fixed = last_fix = used = rejected = 0
    all_nis = [np.empty(0)]
    for k, (ensemble, mask) in enumerate(zip(ensembles, masks, strict=True)):
        if k:
            model.propagate(x, P, 1e-9 * (ensemble.t_ns - ensembles[k - 1].t_ns), float(changes[k]))
        batch = beams(model, ensemble, mask, noise.sd_mps(ensemble.settings))
        cells = len(batch.z)
        if k < fixes and np.isfinite(ensemble.bottom_mps[:2]).all():
            batch = batch.joined(over_ground(model, ensemble))
        accepted, nis = correct(x, P, batch, gate)
        if accepted[cells:].any():
            fixed, last_fix = fixed + 1, k
        used, rejected = used + int(accepted[:cells].sum()), rejected + int((~accepted[:cells]).sum())
        all_nis.append(nis[:cells])
        states.append((x[POSITION].copy(), x[VELOCITY].copy(), P[POSITION, POSITION].copy()))
    position_m, velocity_mps, position_covariance = map(np.array, zip(*states, strict=True))
    if parameters.water_change_mps_per_rtm:
        t_s = 1e-9 * np.array([e.t_ns - ensembles[last_fix].t_ns for e in ensembles[last_fix:]], dtype=np.float64)
        added = added_variance(t_s, velocity_mps[last_fix:], parameters.water_change_mps_per_rtm)
        position_covariance[last_fix:] += added[:, None, None] * np.eye(2)
    there = sum(int(np.isfinite(e.velocity_mps).sum()) for e in ensembles)
    return Track(
        t_ns=tuple(e.t_ns for e in ensembles),
        position_m=position_m,
        position_covariance=position_covariance,
        velocity_mps=velocity_mps,
        fixes=fixed,
        cells_used=used,
        cells_screened=there - used - rejected,
        cells_rejected=rejected,
        nis=float(np.median(rows)) / float(chi2.median(1)) if len(rows := np.concatenate(all_nis)) else 0.0,
        water=_water(model, x, P),
    )


def _nodes(ensembles: Sequence[BeamEnsemble], masks: Sequence[Mask]) -> Array:
    """Return the depths of the grid points (m): all observed depths, a cell apart, at most ``MAX_GRID_POINTS``."""
    cell_m = min(e.settings.cell_m for e in ensembles)
    seen = [e.depth_m + e.below_m[mask] for e, mask in zip(ensembles, masks, strict=True)]
    depths = np.concatenate([*seen, [e.depth_m for e in ensembles]])
    top = max(float(depths.min()) - cell_m, 0.0)
    bottom = float(depths.max()) + cell_m
    count = int(np.clip(np.ceil((bottom - top) / cell_m), 1, MAX_GRID_POINTS - 1)) + 1
    nodes: Array = np.linspace(top, bottom, count)
    return nodes


def _ranges(ensembles: Sequence[BeamEnsemble], masks: Sequence[Mask]) -> Array:
    """Return the ranges at which the beams have biases (m), (C,).

    They are those of the cells, up to the last one that is ever used. If the cells change within the dive, the ranges
    are a smallest cell apart, at most ``MAX_RANGES``.
    """
    used = [e.range_m[mask.any(axis=0)] for e, mask in zip(ensembles, masks, strict=True)]
    last_m = max((float(ranges[-1]) for ranges in used if len(ranges)), default=0.0)
    first = ensembles[0]
    if all(e.settings.setup == first.settings.setup for e in ensembles):
        spacing_m = first.range_m[1] - first.range_m[0] if len(first.range_m) > 1 else 1.0
        within: Array = first.range_m[first.range_m <= max(last_m, first.range_m[0]) + 0.5 * spacing_m]
        return within
    near_m = min(float(e.range_m[0]) for e in ensembles)
    spacing_m = min(e.settings.cell_m / math.cos(e.settings.beam_angle_rad) for e in ensembles)
    count = int(np.clip(np.ceil((last_m - near_m) / spacing_m), 1, MAX_RANGES - 1)) + 1
    ranges: Array = np.linspace(near_m, max(last_m, near_m + spacing_m), count)
    return ranges


def _water(model: Model, x: Array, P: Array) -> WaterPrior:
    """Return the estimated current. The common variance is the smallest covariance of any two depths."""
    sd = np.sqrt(np.maximum(*(np.diagonal(P)[axis] for axis in (model.north, model.east))))
    shared = min(float(P[axis, axis].min()) for axis in (model.north, model.east))
    return WaterPrior(
        depth_m=model.depth_m.copy(),
        north_mps=x[model.north].copy(),
        east_mps=x[model.east].copy(),
        sd_mps=sd,
        sd_common_mps=float(np.sqrt(max(shared, 0.0))),
    )


def added_variance(t_s: Array, velocity_mps: Array, change_mps_per_rtm: float) -> Array:
    """Return the variance of position that the change along the track adds in each axis (m^2), (N,).

    Parameters
    ----------
    t_s : (N,) times (s), the first that of the last fix.
    velocity_mps : (N, 2) velocity over ground.
    change_mps_per_rtm : q_h.
    """
    dt = np.diff(t_s, prepend=t_s[0])
    run = change_mps_per_rtm**2 * np.hypot(*velocity_mps.T) * dt
    # sum of (t_k - t_i)^2 run_i over i <= k, from three running sums
    zero, one, two = (np.cumsum(run * t_s**power) for power in range(3))
    variance: Array = t_s**2 * zero - 2.0 * t_s * one + two
    return np.maximum(variance, 0.0)
