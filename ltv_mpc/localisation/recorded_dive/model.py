"""Model of a recorded dive without IMU: states, prior, propagation, measurement rows and update of one ensemble.

State   x = [p, v, w, beta, c]
        p, v   position and velocity over ground (m, m/s), north and east
        w      vertical velocity of the vehicle through the water (m/s, down): unknown in every ensemble
        beta   bias of beam i at range j (m/s), (4 C); a cell has that of the nearest range
        c      current north at the grid points, then east (m/s), (2 K); linear between grid points
Propagation over dt:  p += v dt,  v a random walk of intensity q:  Q = q^2 [dt^3/3, dt^2/2; dt^2/2, dt]
        q of each step as in ``filter.py``
        beta := f beta + noise,  f = exp(-dt / tau), noise of covariance (1 - f^2) B: stationary covariance B
        c += noise of covariance q_c^2 dt rho,  rho = exp(-|z1 - z2| / L): neighbours change together
Prior   B(r1, r2) = s_b^2 + (s_r^2 + s_n^2 exp(-(r1 + r2) / r_n)) exp(-|r1 - r2| / L_r),  beams independent
        c: s_m^2 + s^2 rho, as in ``current_model.py``
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

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve, cholesky, solve_triangular

from ltv_mpc.localisation.pd0.beams import BeamEnsemble
from ltv_mpc.localisation.pd0.records import BEAMS
from ltv_mpc.localisation.recorded_dive.parameters import DiveParameters
from ltv_mpc.localisation.recorded_dive.screening import Mask
from ltv_mpc.messages import Array

POSITION = slice(0, 2)
VELOCITY = slice(2, 4)
HEAVE = 4
BIAS = 5
HEAVE_SD_MPS = 1.0
"""Standard deviation of w in every ensemble (m/s)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """Process model for K evenly spaced grid points of the current and C cells of each beam."""

    parameters: DiveParameters
    depth_m: Array  # (K,) depths of the grid points
    range_m: Array  # (C,) ranges of the biases along a beam
    bias: Array  # B, (C, C)
    correlation: Array  # rho, (K, K)

    @classmethod
    def of(cls, parameters: DiveParameters, depth_m: Array, range_m: Array) -> Model:
        """Return the model.

        Parameters
        ----------
        parameters : assumptions of the filter.
        depth_m : (K,) depths of the grid points, evenly spaced (m).
        range_m : (C,) ranges of the biases along a beam, evenly spaced (m).
        """
        p = parameters
        r1, r2 = range_m[:, None], range_m[None, :]
        varying = p.range_bias_sd_mps**2 + p.near_bias_sd_mps**2 * np.exp(-(r1 + r2) / p.near_bias_length_m)
        bias = p.beam_bias_sd_mps**2 + varying * np.exp(-np.abs(r1 - r2) / p.range_bias_length_m)
        correlation = np.exp(-np.abs(depth_m[:, None] - depth_m[None, :]) / p.water_correlation_length_m)
        return cls(parameters=p, depth_m=depth_m, range_m=range_m, bias=bias, correlation=correlation)

    @property
    def cells(self) -> int:
        """Number of biases of one beam C."""
        return len(self.range_m)

    @property
    def spacing_m(self) -> float:
        """Spacing of the grid points (m)."""
        return float(self.depth_m[1] - self.depth_m[0])

    @property
    def biases(self) -> slice:
        """Slice of the biases of all beams."""
        return slice(BIAS, BIAS + BEAMS * self.cells)

    @property
    def north(self) -> slice:
        """Slice of the current north."""
        return slice(self.biases.stop, self.biases.stop + len(self.depth_m))

    @property
    def east(self) -> slice:
        """Slice of the current east."""
        return slice(self.north.stop, self.north.stop + len(self.depth_m))

    @property
    def size(self) -> int:
        """Number of states n."""
        return BIAS + BEAMS * self.cells + 2 * len(self.depth_m)

    def prior(self) -> tuple[Array, Array]:
        """Return the prior estimate (n,) and covariance (n, n); the position is 0 by definition."""
        p = self.parameters
        P = np.zeros((self.size, self.size))
        P[VELOCITY, VELOCITY] = p.velocity_sd_mps**2 * np.eye(2)
        P[HEAVE, HEAVE] = HEAVE_SD_MPS**2
        P[self.biases, self.biases] = np.kron(np.eye(BEAMS), self.bias)
        for axis in (self.north, self.east):
            P[axis, axis] = p.water_mean_sd_mps**2 + p.water_sd_mps**2 * self.correlation
        return np.zeros(self.size), P

    def propagate(self, x: Array, P: Array, dt: float, change_mps_per_rts: float) -> None:
        """Propagate estimate and covariance in place.

        Parameters
        ----------
        x : (n,) estimate.
        P : (n, n) covariance.
        dt : time (s).
        change_mps_per_rts : q of this step.
        """
        p = self.parameters
        # p += v dt
        x[POSITION] += dt * x[VELOCITY]
        P[POSITION, :] += dt * P[VELOCITY, :]
        P[:, POSITION] += dt * P[:, VELOCITY]
        q2 = change_mps_per_rts**2
        P[:HEAVE, :HEAVE] += q2 * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(2))
        x[HEAVE] = P[HEAVE, :] = P[:, HEAVE] = 0.0
        P[HEAVE, HEAVE] = HEAVE_SD_MPS**2
        f = math.exp(-dt / p.bias_tau_s)
        x[self.biases] *= f
        P[self.biases, :] *= f
        P[:, self.biases] *= f
        P[self.biases, self.biases] += (1 - f * f) * np.kron(np.eye(BEAMS), self.bias)
        for axis in (self.north, self.east):
            P[axis, axis] += p.water_change_mps_per_rts**2 * dt * self.correlation


OVERLAP = 1.3
"""Factor of the variance for correlated neighbours: 1 + 2 x 0.15."""
_TRIANGLE = ((-0.5, 0.25), (0.0, 0.5), (0.5, 0.25))


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
    nearest = np.abs(ensemble.range_m[cell, None] - model.range_m).argmin(axis=1)
    H[each, BIAS + beam * model.cells + nearest] = 1.0
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
