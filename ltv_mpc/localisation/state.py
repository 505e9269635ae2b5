"""What the filter estimates, in which order, and its best guess with its covariance.

State   position, velocity over ground (m, m/s, NED), attitude (body to world), gyro and accelerometer bias (body);
        position north, east at the last satellite epoch (a clone, for TDCP); where the sensors file says that they
        exist: ADCP bias and near-range bias of each beam, ADCP mounting, compass bias;
        and the water's velocity north and east at depths 0, h, 2h, ... (linear between them).
Errors  true minus estimated, except attitudes, whose error is a rotation vector on the left:
        R_true = exp(phi^) R with phi in NED, M_true = exp(mu^) M with mu in body axes.
        So the error of a level vehicle's accelerations changes slowly, whatever its heading does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ltv_mpc.frames import rotation_exp
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.suite import Suite
from ltv_mpc.signals import Array

POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 9)
GYRO_BIAS = slice(9, 12)
ACCELEROMETER_BIAS = slice(12, 15)
CORE = 15
"""The states that the inertial unit drives: the first fifteen, in every layout."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Where each state stands behind the core. A state that the suite does not have is an empty slice."""

    epoch: slice  # north, east at the last satellite epoch
    beam_bias: slice
    near_bias: slice
    mounting: slice
    compass_bias: slice
    north: slice  # of the water, by depth
    east: slice
    size: int

    @classmethod
    def of(cls, suite: Suite, config: EstimatorConfig) -> Layout:
        """The states that ``suite`` calls for: a bias of standard deviation 0 is left out."""
        end = CORE

        def take(count: int) -> slice:
            nonlocal end
            start, end = end, end + count
            return slice(start, end)

        cells = len(grid(config))
        adcp = suite.adcp
        epoch = take(2)
        beam_bias = take(4 if adcp.beam_bias_sd_mps > 0 else 0)
        near_bias = take(4 if adcp.near_bias_sd_mps > 0 else 0)
        mounting = take(3 if adcp.mounting_known_to_rad > 0 else 0)
        compass_bias = take(1 if suite.compass.bias_sd_rad > 0 else 0)
        north, east = take(cells), take(cells)
        return cls(
            epoch=epoch,
            beam_bias=beam_bias,
            near_bias=near_bias,
            mounting=mounting,
            compass_bias=compass_bias,
            north=north,
            east=east,
            size=end,
        )


def grid(config: EstimatorConfig) -> Array:
    """Depths of the water's states (m), (K,): 0 to the first multiple of the cell that reaches the deepest."""
    cells = int(np.ceil(config.deepest_m / config.cell_m - 1e-9)) + 1
    depths: Array = config.cell_m * np.arange(cells, dtype=np.float64)
    return depths


@dataclass(slots=True, kw_only=True)
class Belief:
    """The filter's best guess at ``t_ns`` and the covariance of its error.

    ``x`` (n,) holds every state but the two attitudes, which are ``R`` (3, 3) and ``mounting`` (3, 3); its entries at
    their places are not used. ``P`` (n, n) is symmetric, C-contiguous.
    """

    layout: Layout
    t_ns: int
    x: Array
    R: Array
    mounting: Array
    P: Array
    epoch_t_ns: int  # of the clone

    @classmethod
    def blank(cls, layout: Layout, t_ns: int) -> Belief:
        """All zero and certain, level, heading north."""
        n = layout.size
        return cls(
            layout=layout,
            t_ns=t_ns,
            x=np.zeros(n),
            R=np.eye(3),
            mounting=np.eye(3),
            P=np.zeros((n, n)),
            epoch_t_ns=t_ns,
        )

    def copy(self) -> Belief:
        """Independent of this one."""
        return replace(self, x=self.x.copy(), R=self.R.copy(), mounting=self.mounting.copy(), P=self.P.copy())

    def add(self, error: Array) -> None:
        """Estimate + error, (n,), in the sense of the file's head. The covariance is not touched."""
        self.x += error
        self.R = rotation_exp(error[ATTITUDE]) @ self.R
        if self.layout.mounting.stop > self.layout.mounting.start:
            self.mounting = rotation_exp(error[self.layout.mounting]) @ self.mounting

    def clone_position(self) -> None:
        """The position of this instant becomes the satellite epoch's: x_e := p, so P_e. := P_p. and P_ee := P_pp."""
        e = self.layout.epoch
        p = slice(POSITION.start, POSITION.start + 2)
        self.x[e] = self.x[p]
        self.P[e, :] = self.P[p, :]
        self.P[:, e] = self.P[:, p]
        self.epoch_t_ns = self.t_ns
