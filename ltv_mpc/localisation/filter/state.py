"""State vector of the estimator, the order of its states, and the estimate with its covariance.

State   position p and velocity over ground v (m, m/s, NED), attitude R (body to world),
        gyro bias b_g (rad/s, FRD) and accelerometer bias b_a (m/s2, FRD): the fifteen core states;
        antenna position north and east at the last satellite epoch (m; a stochastic clone, used by TDCP);
        if the sensor configuration has them: ADCP bias and near-range bias of each beam (m/s), ADCP mounting M,
        compass bias (rad), relative error of the sound speed used for LBL ranges;
        current common to all depths, north and east (m/s);
        current north and east (m/s) at the depth grid 0, h, 2h, ..., linear between grid points
        (``current_model.py``).
Errors  true minus estimated. Attitude errors are rotation vectors on the left:
        R_true = exp(phi^) R with phi in NED, M_true = exp(mu^) M with mu in body axes.
        With phi in NED the acceleration error of a level vehicle changes slowly, whatever its heading does.
Source  Groves 2013, chapter 14 (error state in a local frame).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ltv_mpc.currents import grid_depths
from ltv_mpc.frames import rotation_exp, skew
from ltv_mpc.localisation.adaptive.failure_signatures import FailureSignatures
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.messages import Array, Triple

if TYPE_CHECKING:  # the sensors import this file
    from ltv_mpc.localisation.sensor_config import SensorConfig

POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
ATTITUDE = slice(6, 9)
GYRO_BIAS = slice(9, 12)
ACCELEROMETER_BIAS = slice(12, 15)
CORE = 15
"""Number of core states, which the IMU propagates. They are the first states of every layout."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Slices of the state vector behind the core. A state that the sensor configuration lacks is an empty slice."""

    epoch: slice  # antenna north, east at the last satellite epoch
    beam_bias: slice
    near_bias: slice
    mounting: slice
    compass_bias: slice
    sound_speed: slice  # true over assumed sound speed, minus 1
    mean: slice  # current common to all depths, north and east: m of ``current_model.py``
    north: slice  # current north at the grid points
    east: slice
    size: int  # number of states n

    @classmethod
    def of(cls, sensor_config: SensorConfig, config: EstimatorConfig) -> Layout:
        """Return the layout for a sensor configuration. A bias of standard deviation 0 gets no state.

        Parameters
        ----------
        sensor_config : sensors of the vehicle.
        config : depth grid (``deepest_m``, ``cell_m``).

        Returns
        -------
        Layout with ``size`` states.
        """
        adcp, lbl = sensor_config.adcp, sensor_config.lbl
        cells = len(grid(config))
        sizes = {
            "epoch": 2,
            "beam_bias": 4 if adcp.beam_bias_sd_mps > 0 else 0,
            "near_bias": 4 if adcp.near_bias_sd_mps > 0 else 0,
            "mounting": 3 if adcp.mounting_known_to_rad > 0 else 0,
            "compass_bias": 1 if sensor_config.compass.bias_sd_rad > 0 else 0,
            "sound_speed": 1 if lbl is not None and lbl.sound_speed_sd_mps > 0 else 0,
            "mean": 2,
            "north": cells,
            "east": cells,
        }
        ends = itertools.accumulate(sizes.values(), initial=CORE)
        states = {name: slice(start, stop) for name, (start, stop) in zip(sizes, itertools.pairwise(ends), strict=True)}
        return cls(**states, size=states["east"].stop)


def grid(config: EstimatorConfig) -> Array:
    """Return the depths of the grid points (m), (G,): 0, h, 2h, ... to the first multiple of h >= ``deepest_m``."""
    return grid_depths(config.deepest_m, config.cell_m)


@dataclass(slots=True, kw_only=True)
class Belief:
    """State estimate at ``t_ns`` with the covariance of its error.

    ``x`` (n,) holds every state except the two attitudes, which are ``R`` (3, 3, body to NED) and ``mounting`` (3, 3).
    The attitude entries of ``x`` hold the sum of their corrections (rad). ``P`` (n, n) is symmetric and C-contiguous.
    """

    layout: Layout
    t_ns: int
    x: Array
    R: Array
    mounting: Array
    P: Array
    signatures: FailureSignatures  # mean errors under fault hypotheses that the filter does not model
    epoch_t_ns: int  # time of the cloned position

    @classmethod
    def blank(cls, layout: Layout, t_ns: int) -> Belief:
        """Return an estimate of zero with zero covariance: level, heading north, still water.

        Parameters
        ----------
        layout : order of the states.
        t_ns : time of the estimate.
        """
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
        )

    def copy(self) -> Belief:
        """Return an independent copy."""
        return replace(
            self,
            x=self.x.copy(),
            R=self.R.copy(),
            mounting=self.mounting.copy(),
            P=self.P.copy(),
            signatures=self.signatures.copy(),
        )

    def apply_error(self, error: Array) -> None:
        """Add an error to the estimate: x := x + e, R := exp(phi^) R, M := exp(mu^) M. The covariance does not change.

        Parameters
        ----------
        error : (n,) error e, with the sign convention above.
        """
        self.x += error
        self.R[:] = rotation_exp(error[ATTITUDE]) @ self.R
        mounting = self.layout.mounting
        if mounting.stop > mounting.start:
            self.mounting = rotation_exp(error[mounting]) @ self.mounting

    def propagate_bias(self, states: slice, sd: float, tau_s: float, seconds: float) -> None:
        """Propagate biases that are first-order Gauss-Markov processes, b := exp(-t / tau) b.

        Parameters
        ----------
        states : states of the biases, with one standard deviation and one time constant; may be empty.
        sd : standard deviation of the ensemble, in the unit of the state.
        tau_s : time constant (s).
        seconds : time t (s).
        """
        if states.stop == states.start:
            return
        keep = math.exp(-seconds / tau_s)
        for array in (self.x[states], self.P[states, :], self.P[:, states], self.signatures.error[states]):
            array *= keep
        self.P[states, states] += sd**2 * (1.0 - keep * keep) * np.eye(states.stop - states.start)

    def clone_position(self, lever_m: Triple = (0.0, 0.0, 0.0)) -> None:
        """Clone the current antenna position into the satellite epoch: x_e := p + q with q = R l.

        The error of the clone is dp + phi x q = T e, so P_e. := T P and P_ee := T P T^T (stochastic cloning).

        Parameters
        ----------
        lever_m : antenna position l relative to the origin of the body (m, FRD).
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
