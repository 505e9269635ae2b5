"""Process model of a recorded dive without IMU: states, prior and propagation.

State   x = [p, v, w, beta, c]
        p, v   position and velocity over ground (m, m/s), north and east
        w      vertical velocity of the vehicle through the water (m/s, down): unknown in every ensemble
        beta   bias of beam i at range j (m/s), (4 C); a cell has that of the nearest range
        c      current north at the grid points, then east (m/s), (2 K); linear between grid points
Propagation over dt:  p += v dt,  v a random walk of intensity q:  Q = q^2 [dt^3/3, dt^2/2; dt^2/2, dt]
        q of each step as in velocity_change.py
        beta := f beta + noise,  f = exp(-dt / tau), noise of covariance (1 - f^2) B: stationary covariance B
        c += noise of covariance q_c^2 dt rho,  rho = exp(-|z1 - z2| / L): neighbours change together
Prior   B(r1, r2) = s_b^2 + (s_r^2 + s_n^2 exp(-(r1 + r2) / r_n)) exp(-|r1 - r2| / L_r),  beams independent
        c: s_m^2 + s^2 rho, as in ``current_model.py``
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ltv_mpc.localisation.pd0.records import BEAMS
from ltv_mpc.localisation.recorded_dive.parameters import DiveParameters
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

    def nearest(self, range_m: Array) -> npt.NDArray[np.int64]:
        """Return the indices of the nearest ranges that have a bias.

        Parameters
        ----------
        range_m : ranges of cells (m).
        """
        if self.cells == 1:
            return np.zeros(len(range_m), dtype=np.int64)
        place = (range_m - self.range_m[0]) / (self.range_m[1] - self.range_m[0])
        nearest: npt.NDArray[np.int64] = np.clip(np.rint(place), 0, self.cells - 1).astype(np.int64)
        return nearest

    @property
    def north(self) -> slice:
        """Slice of the current north."""
        start = BIAS + BEAMS * self.cells
        return slice(start, start + len(self.depth_m))

    @property
    def east(self) -> slice:
        """Slice of the current east."""
        return slice(self.north.stop, self.north.stop + len(self.depth_m))

    @property
    def size(self) -> int:
        """Number of states n."""
        return BIAS + BEAMS * self.cells + 2 * len(self.depth_m)

    def bias_of(self, beam: int) -> slice:
        """Return the slice of the biases of one beam.

        Parameters
        ----------
        beam : number of the beam, 0 to 3.
        """
        start = BIAS + beam * self.cells
        return slice(start, start + self.cells)

    def prior(self) -> tuple[Array, Array]:
        """Return the prior estimate (n,) and covariance (n, n); the position is 0 by definition."""
        p = self.parameters
        P = np.zeros((self.size, self.size))
        P[VELOCITY, VELOCITY] = p.velocity_sd_mps**2 * np.eye(2)
        P[HEAVE, HEAVE] = HEAVE_SD_MPS**2
        for beam in range(BEAMS):
            P[self.bias_of(beam), self.bias_of(beam)] = self.bias
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
        for a in range(2):
            P[a, a] += q2 * dt**3 / 3
            P[a, a + 2] += q2 * dt**2 / 2
            P[a + 2, a] += q2 * dt**2 / 2
            P[a + 2, a + 2] += q2 * dt
        x[HEAVE] = 0.0
        P[HEAVE, :] = 0.0
        P[:, HEAVE] = 0.0
        P[HEAVE, HEAVE] = HEAVE_SD_MPS**2
        f = math.exp(-dt / p.bias_tau_s)
        all_beams = slice(BIAS, self.north.start)
        x[all_beams] *= f
        P[all_beams, :] *= f
        P[:, all_beams] *= f
        for beam in range(BEAMS):
            P[self.bias_of(beam), self.bias_of(beam)] += (1 - f * f) * self.bias
        for axis in (self.north, self.east):
            P[axis, axis] += p.water_change_mps_per_rts**2 * dt * self.correlation
