"""Measurement model and update of one ADCP ensemble.

Beams   z_ij = u_i . (c(d_ij) - v) - u_id w + beta_ij + n,   v and c horizontal, d_ij the depth of the cell's middle
        A cell measures the water over twice its length with triangular weights: here 1/4, 1/2, 1/4 at half a cell
        above, at and below its middle.
Bottom  z = v + n, north and east. The vertical velocity is not used: w is common to all beams.
Noise   Neighbouring cells share half of their water, so their noise is correlated by about 0.15. The model has
        independent noise with 1 + 2 x 0.15 times the variance instead.
Update  S = H P H^T + R;  for the rows that pass, S = L L^T, W = L^-1 H P:  x += W^T L^-1 r,  P -= W^T W
Gate    Velocity and w are nearly unknown before an ensemble, so each row is tested against all others: with A = S^-1,
        the innovation of row i given all others is (A r)_i / A_ii with variance 1 / A_ii. While the largest
        (A r)_i^2 / A_ii exceeds the chi-square quantile, that row is removed (A := A - a_i a_i^T / A_ii).
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve, cholesky, solve_triangular

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.recorded_dive.model import BIAS, HEAVE, VELOCITY, Model
from ltv_mpc.messages import Array

OVERLAP = 1.3
"""Factor of the variance for correlated neighbours: 1 + 2 x 0.15."""
_TRIANGLE = ((-0.5, 0.25), (0.0, 0.5), (0.5, 0.25))

Mask: TypeAlias = npt.NDArray[np.bool_]


class Batch(NamedTuple):
    """m scalar measurements z = H x + n with n of ``variance``, independent."""

    H: Array  # (m, n)
    z: Array  # (m,)
    variance: Array  # (m,)

    def joined(self, other: Batch) -> Batch:
        """Return this batch followed by another.

        Parameters
        ----------
        other : further rows of the same states.
        """
        return Batch(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


def beams(model: Model, ensemble: BeamEnsemble, mask: Mask, sd_mps: Array) -> Batch:
    """Return the rows of the usable cells.

    Parameters
    ----------
    model : states.
    ensemble : beam velocities and directions.
    mask : (4, cells) usable cells.
    sd_mps : (cells,) beam noise with all pings good (m/s).
    """
    beam, cell = np.nonzero(mask)
    cell_m = ensemble.settings.cell_m
    m = len(beam)
    u = ensemble.direction[beam]
    each = np.arange(m)
    H = np.zeros((m, model.size))
    H[:, VELOCITY] = -u[:, :2]
    H[:, HEAVE] = -u[:, 2]
    H[each, BIAS + beam * model.cells + model.nearest(ensemble.range_m[cell])] = 1.0
    h, last = model.spacing_m, len(model.depth_m) - 2
    depth = ensemble.depth_m + ensemble.below_m[beam, cell]
    for shift, weight in _TRIANGLE:
        place = (depth + shift * cell_m - model.depth_m[0]) / h
        k = np.clip(np.floor(place), 0, last).astype(np.int64)
        s = np.clip(place - k, 0.0, 1.0)
        for axis, start in ((0, model.north.start), (1, model.east.start)):
            H[each, start + k] += weight * (1 - s) * u[:, axis]
            H[each, start + k + 1] += weight * s * u[:, axis]
    variance = OVERLAP * sd_mps[cell] ** 2 / ensemble.good[beam, cell]
    return Batch(H, ensemble.velocity_mps[beam, cell], variance)


def over_ground(model: Model, ensemble: BeamEnsemble) -> Batch:
    """Return the rows of the bottom track, north and east.

    Parameters
    ----------
    model : states.
    ensemble : its bottom track must be finite.
    """
    H = np.zeros((2, model.size))
    H[:, VELOCITY] = np.eye(2)
    return Batch(H, ensemble.bottom_mps[:2], np.full(2, model.parameters.bottom_sd_mps**2))


def correct(x: Array, P: Array, batch: Batch, gate: float) -> tuple[npt.NDArray[np.bool_], Array]:
    """Update estimate and covariance in place.

    Parameters
    ----------
    x : (n,) estimate.
    P : (n, n) covariance.
    batch : m rows.
    gate : quantile of the chi-square distribution with one degree of freedom.

    Returns
    -------
    accepted : (m,) rows that passed the gate.
    nis : (m,) (A r)_i^2 / A_ii of each row before the gate.
    """
    H, z, variance = batch
    accepted = np.ones(len(z), dtype=np.bool_)
    if not len(z):
        return accepted, np.zeros(0)
    r = z - H @ x
    HP = H @ P
    S = HP @ H.T + np.diag(variance)
    A = cho_solve((cholesky(S, lower=True), True), np.eye(len(z)))
    nis = (A @ r) ** 2 / np.diagonal(A)
    y, t = A @ r, nis
    while t[worst := int(np.argmax(t))] > gate:
        accepted[worst] = False
        y = y - A[worst] * (y[worst] / A[worst, worst])
        A = A - np.outer(A[worst], A[worst]) / A[worst, worst]
        t = np.zeros(len(z))
        t[accepted] = y[accepted] ** 2 / np.diagonal(A)[accepted]
    if accepted.any():
        L = cholesky(S[np.ix_(accepted, accepted)], lower=True)
        W = solve_triangular(L, HP[accepted], lower=True)
        x += W.T @ solve_triangular(L, r[accepted], lower=True)
        P -= W.T @ W
    return accepted, nis
