"""What the filter estimates, in which order, and its best guess with its covariance.

State   position, velocity over ground (m, m/s, NED), attitude (body to world), gyro and accelerometer bias (body);
        antenna's north, east at the last satellite epoch (a clone, for TDCP); where the sensors file says that they
        exist: ADCP bias and near-range bias of each beam, ADCP mounting, compass bias, and the relative error of the
        sound speed that LBL ranges are reckoned with;
        the part of the water's velocity that all depths have in common, north and east; and the water's velocity
        north and east at a window of the depths 0, h, 2h, ... (linear between them; ``column.py``, ``grid_window.py``).
Errors  true minus estimated, except attitudes, whose error is a rotation vector on the left:
        R_true = exp(phi^) R with phi in NED, M_true = exp(mu^) M with mu in body axes.
        So the error of a level vehicle's accelerations changes slowly, whatever its heading does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ltv_mpc import so3
from ltv_mpc.frames import rotation_exp, skew
from ltv_mpc.jit import jit
from ltv_mpc.localisation.adaptive.failure_signatures import FailureSignatures
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.water.column import WaterColumn
from ltv_mpc.messages import Array, Triple

if TYPE_CHECKING:  # the sensors import this file
    from ltv_mpc.localisation.sensor_config import SensorConfig
    from ltv_mpc.localisation.sensors.adcp import Adcp

POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 9)
GYRO_BIAS = slice(9, 12)
ACCELEROMETER_BIAS = slice(12, 15)
_ATTITUDE = ATTITUDE.start
CORE = 15
"""The states that the inertial unit drives: the first fifteen, in every layout."""

_PLANNED_M = 3.0
"""How far the controller's plan may lead up or down: 10 s at 0.3 m/s."""

_ROLLS_RAD = 0.5
"""Roll and pitch that the vehicle may have at most, so that a beam which looks down does not look up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Where each state stands behind the core. A state that the suite does not have is an empty slice."""

    epoch: slice  # north, east at the last satellite epoch
    beam_bias: slice
    near_bias: slice
    mounting: slice
    compass_bias: slice
    sound_speed: slice  # true over assumed, less 1
    mean: slice  # of the water, north and east: m of ``column.py``
    north: slice  # of the water at the window's nodes
    east: slice
    nodes: int  # of the whole grid
    size: int

    @classmethod
    def of(cls, suite: SensorConfig, config: EstimatorConfig) -> Layout:
        """The states that ``suite`` calls for: a bias of standard deviation 0 is left out."""
        end = CORE

        def take(count: int) -> slice:
            nonlocal end
            start, end = end, end + count
            return slice(start, end)

        adcp = suite.adcp
        nodes = len(grid(config))
        above_m, below_m = reach_m(adcp)
        cells = min(nodes, math.ceil((config.kept_m + above_m + below_m) / config.cell_m) + 3)
        epoch = take(2)
        beam_bias = take(4 if adcp.beam_bias_sd_mps > 0 else 0)
        near_bias = take(4 if adcp.near_bias_sd_mps > 0 else 0)
        mounting = take(3 if adcp.mounting_known_to_rad > 0 else 0)
        compass_bias = take(1 if suite.compass.bias_sd_rad > 0 else 0)
        sound_speed = take(1 if suite.lbl is not None and suite.lbl.sound_speed_sd_mps > 0 else 0)
        mean = take(2)
        north, east = take(cells), take(cells)
        return cls(
            epoch=epoch,
            beam_bias=beam_bias,
            near_bias=near_bias,
            mounting=mounting,
            compass_bias=compass_bias,
            sound_speed=sound_speed,
            mean=mean,
            north=north,
            east=east,
            nodes=nodes,
            size=end,
        )


def grid(config: EstimatorConfig) -> Array:
    """Depths of the water's nodes (m), (G,): 0 to the first multiple of the cell that reaches the deepest."""
    cells = int(np.ceil(config.deepest_m / config.cell_m - 1e-9)) + 1
    depths: Array = config.cell_m * np.arange(cells, dtype=np.float64)
    return depths


def reach_m(adcp: Adcp) -> tuple[float, float]:
    """How far above and below the vehicle its nodes must be states: where a beam or the controller's plan may be."""
    tilt = math.acos(max(-1.0, min(1.0, math.cos(adcp.mounting_rad[0]) * math.cos(adcp.mounting_rad[1]))))
    nearby = _PLANNED_M + math.hypot(*adcp.lever_arm_m)
    upward = tilt + adcp.beam_angle_rad + _ROLLS_RAD > 0.5 * math.pi
    downward = tilt - adcp.beam_angle_rad - _ROLLS_RAD < 0.5 * math.pi
    return nearby + upward * adcp.range_m, nearby + downward * adcp.range_m


@jit
def apply_error(x: Array, R: Array, error: Array) -> None:
    """x := x + error, (n,), and R := exp(phi^) R, (3, 3), with phi the attitude's part of it, in place."""
    for k in range(len(x)):
        x[k] += error[k]
    phi = error[_ATTITUDE : _ATTITUDE + 3]
    so3.write(so3.multiply(so3.exp(phi[0], phi[1], phi[2]), so3.read(R)), R)


@dataclass(slots=True, kw_only=True)
class Belief:
    """The filter's best guess at ``t_ns`` and the covariance of its error.

    ``x`` (n,) holds every state but the two attitudes, which are ``R`` (3, 3) and ``mounting`` (3, 3); at their places
    it has the sum of their corrections (rad). ``P`` (n, n) is symmetric, C-contiguous.
    """

    layout: Layout
    t_ns: int
    x: Array
    R: Array
    mounting: Array
    P: Array
    signatures: FailureSignatures  # what hypotheses that the filter knows nothing of would do to it
    epoch_t_ns: int  # of the clone
    column: WaterColumn  # what belongs to the water beside its states

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
            signatures=FailureSignatures.of(n, 0),
            epoch_t_ns=t_ns,
            column=WaterColumn.certain(layout.nodes),
        )

    def copy(self) -> Belief:
        """Independent of this one."""
        return replace(
            self,
            x=self.x.copy(),
            R=self.R.copy(),
            mounting=self.mounting.copy(),
            P=self.P.copy(),
            signatures=self.signatures.copy(),
            column=self.column.copy(),
        )

    def apply_error(self, error: Array) -> None:
        """Estimate + error, (n,), in the sense of the file's head. The covariance is not touched."""
        apply_error(self.x, self.R, error)
        self.apply_mounting_error(error)

    def apply_mounting_error(self, error: Array) -> None:
        """The part of ``add`` that is the mounting's."""
        mounting = self.layout.mounting
        if mounting.stop > mounting.start:
            self.mounting = rotation_exp(error[mounting]) @ self.mounting

    def clone_position(self, lever_m: Triple = (0.0, 0.0, 0.0)) -> None:
        """The antenna's position of this instant becomes the satellite epoch's: x_e := p + q with q = R l.

        Its error is dp + phi x q =: T error, so P_e. := T P and P_ee := T P T^T.
        """
        e = self.layout.epoch
        p = slice(POSITION.start, POSITION.start + 2)
        q = self.R @ np.array(lever_m)
        J = -skew(q)[:2]
        rows = self.P[p, :] + J @ self.P[ATTITUDE, :]
        own = rows[:, p] + rows[:, ATTITUDE] @ J.T
        self.x[e] = self.x[p] + q[:2]
        self.P[e, :] = rows
        self.P[:, e] = rows.T
        self.P[e, e] = 0.5 * (own + own.T)
        E = self.signatures.error
        E[e] = E[p] + J @ E[ATTITUDE]
        self.epoch_t_ns = self.t_ns
