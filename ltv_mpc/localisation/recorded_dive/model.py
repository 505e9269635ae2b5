"""The states of a recorded dive without inertial unit, their prior and how they change.

State   x = [p, v, w, beta, c]
        p, v   position and velocity over ground (m, m/s), north and east
        w      vertical velocity of the vehicle through the water (m/s, down): free in every ensemble
        beta   bias of beam i in cell j (m/s), (4 C)
        c      water north at the nodes' depths, then east (m/s), (2 K); linear between nodes
Change  over dt:  p += v dt,  v a random walk of intensity q:  Q = q^2 [dt^3/3, dt^2/2; dt^2/2, dt]
        beta := f beta + noise,  f = exp(-dt / tau), noise of covariance (1 - f^2) B: its ensemble stays B
        c += noise of covariance q_c^2 dt rho,  rho = exp(-|z1 - z2| / L): neighbours change together
Prior   B(r1, r2) = s_b^2 + (s_r^2 + s_n^2 exp(-(r1 + r2) / r_n)) exp(-|r1 - r2| / L_r),  beams independent
        c: s_m^2 + s^2 rho, as in ``current_model.py``
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ltv_mpc.localisation.pd0.records import BEAMS
from ltv_mpc.localisation.recorded_dive.parameters import DiveParameters
from ltv_mpc.messages import Array

POSITION = slice(0, 2)
VELOCITY = slice(2, 4)
HEAVE = 4
BIAS = 5
HEAVE_SD_MPS = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """Sizes, prior and changes. ``depth_m`` are the water's nodes, evenly spaced."""

    parameters: DiveParameters
    depth_m: Array  # (K,)
    cells: int
    bias: Array  # B, (C, C)
    alike: Array  # rho, (K, K)

    @classmethod
    def of(cls, parameters: DiveParameters, depth_m: Array, range_m: Array) -> Model:
        """``range_m`` (C,) are the cells' ranges along a beam."""
        p = parameters
        r1, r2 = range_m[:, None], range_m[None, :]
        varying = p.range_bias_sd_mps**2 + p.near_bias_sd_mps**2 * np.exp(-(r1 + r2) / p.near_bias_length_m)
        bias = p.beam_bias_sd_mps**2 + varying * np.exp(-np.abs(r1 - r2) / p.range_bias_length_m)
        alike = np.exp(-np.abs(depth_m[:, None] - depth_m[None, :]) / p.water_correlation_length_m)
        return cls(parameters=p, depth_m=depth_m, cells=len(range_m), bias=bias, alike=alike)

    @property
    def spacing_m(self) -> float:
        """Between nodes."""
        return float(self.depth_m[1] - self.depth_m[0])

    @property
    def north(self) -> slice:
        """Of the water."""
        start = BIAS + BEAMS * self.cells
        return slice(start, start + len(self.depth_m))

    @property
    def east(self) -> slice:
        """Of the water."""
        return slice(self.north.stop, self.north.stop + len(self.depth_m))

    @property
    def size(self) -> int:
        """n."""
        return BIAS + BEAMS * self.cells + 2 * len(self.depth_m)

    def bias_of(self, beam: int) -> slice:
        """beta of one beam."""
        start = BIAS + beam * self.cells
        return slice(start, start + self.cells)

    def prior(self) -> tuple[Array, Array]:
        """x (n,) and P (n, n) before anything is measured; the position is where counting begins."""
        p = self.parameters
        P = np.zeros((self.size, self.size))
        P[VELOCITY, VELOCITY] = p.velocity_sd_mps**2 * np.eye(2)
        P[HEAVE, HEAVE] = HEAVE_SD_MPS**2
        for beam in range(BEAMS):
            P[self.bias_of(beam), self.bias_of(beam)] = self.bias
        for axis in (self.north, self.east):
            P[axis, axis] = p.water_mean_sd_mps**2 + p.water_sd_mps**2 * self.alike
        return np.zeros(self.size), P

    def propagate(self, x: Array, P: Array, dt: float) -> None:
        """Both on by ``dt`` (s), in place."""
        p = self.parameters
        # p += v dt
        x[POSITION] += dt * x[VELOCITY]
        P[POSITION, :] += dt * P[VELOCITY, :]
        P[:, POSITION] += dt * P[:, VELOCITY]
        q2 = p.velocity_change_mps_per_rts**2
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
            P[axis, axis] += p.water_change_mps_per_rts**2 * dt * self.alike
