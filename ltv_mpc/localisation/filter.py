"""The error-state Kalman filter: one belief of vehicle and water, moved by the inertial unit, corrected by the rest.

Between two corrections the estimate is integrated sample by sample and only the core's transition is gathered
(``preintegration.py``); ``settle`` then moves the large covariance once:
    P_cc := Phi P_cc Phi^T + Q,  P_cr := Phi P_cr      c: the fifteen core states, r: all others
Biases and water cells behind the core are constants, first-order Gauss-Markov or random walks.
The vehicle's dynamic model is not fused: what the thrusters do is no evidence here.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import TypeAlias

import numpy as np
from scipy.special import chdtri

from ltv_mpc.frames import earth_rate
from ltv_mpc.localisation import water_column
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.correction import correct
from ltv_mpc.localisation.measurements import compass, gnss, pressure, tdcp
from ltv_mpc.localisation.measurements.adcp import AdcpModel
from ltv_mpc.localisation.measurements.rows import Rows
from ltv_mpc.localisation.preintegration import integrate, noise_of
from ltv_mpc.localisation.state import CORE, Belief
from ltv_mpc.localisation.suite import Suite
from ltv_mpc.signals import (
    AdcpPing,
    Array,
    CompassHeading,
    GnssFix,
    ImuSample,
    PressureDepth,
    TdcpFix,
)

Aiding: TypeAlias = GnssFix | TdcpFix | AdcpPing | PressureDepth | CompassHeading
"""What corrects the filter; the inertial unit moves it."""


class Filter:
    """``belief`` stands at ``belief.t_ns``; its covariance only after ``settle``."""

    def __init__(self, suite: Suite, config: EstimatorConfig, belief: Belief) -> None:
        self.belief = belief
        self.rate: tuple[float, float, float] = (0.0, 0.0, 0.0)  # measured last (rad/s, body, bias included)
        self.account: Counter[str] = Counter()  # scalar measurements by "<sensor>.<what came of them>"
        self._suite = suite
        self._config = config
        self._gate = float(chdtri(1, 1.0 - config.gate_probability))  # quantile of chi-square, 1 degree of freedom
        self._adcp = AdcpModel(suite.adcp, belief.layout, config.cell_m)
        self._noise = noise_of(suite.imu)
        self._earth = earth_rate(suite.latitude_rad) if suite.imu.senses_earth_rate else np.zeros(3)
        self._Phi = np.eye(CORE)
        self._Q = np.zeros((CORE, CORE))
        self._pending_ns = 0
        self._at_epoch = False  # a satellite fix came at this instant: its position is cloned when time goes on

    def advance(self, t_ns: int, sample: ImuSample) -> None:
        """Move to ``t_ns`` with the rates of ``sample``, which cover the time from the belief's."""
        belief = self.belief
        if self._at_epoch:
            self._at_epoch = False
            self.settle()
            belief.clone_position()
        step_ns = t_ns - belief.t_ns
        self.rate = sample.angular_rate_radps
        integrate(
            belief.x,
            belief.R,
            self._Phi,
            self._Q,
            self.rate,
            sample.specific_force_mps2,
            step_ns * 1e-9,
            self._noise,
            self._earth,
        )
        belief.t_ns = t_ns
        self._pending_ns += step_ns

    def settle(self) -> None:
        """Bring the whole covariance to the belief's time."""
        if self._pending_ns == 0:
            return
        belief, dt = self.belief, self._pending_ns * 1e-9
        P = belief.P
        cross = self._Phi @ P[:CORE, CORE:]
        P[:CORE, CORE:] = cross
        P[CORE:, :CORE] = cross.T
        P[:CORE, :CORE] = self.core_covariance()
        bias = belief.layout.compass_bias
        if bias.stop > bias.start:
            keep = math.exp(-dt / self._suite.compass.bias_tau_s)
            belief.x[bias] *= keep
            P[bias, :] *= keep
            P[:, bias] *= keep
            P[bias, bias] += self._suite.compass.bias_sd_rad**2 * (1.0 - keep * keep)
        water_column.walk(belief, self._config, dt)
        self._Phi[:] = np.eye(CORE)
        self._Q[:] = 0.0
        self._pending_ns = 0

    def core_covariance(self) -> Array:
        """Of the core at the belief's time, (15, 15), without moving the rest."""
        C = self._Phi @ self.belief.P[:CORE, :CORE] @ self._Phi.T + self._Q
        return 0.5 * (C + C.T)

    @property
    def rate_variance(self) -> float:
        """Of one axis of ``rate`` less its bias (rad2/s2): the angle random walk over one sample."""
        imu = self._suite.imu
        return imu.angle_random_walk_rad_per_rts**2 / (imu.period_ns * 1e-9)

    @property
    def rotation_of_earth(self) -> Array:
        """That the gyros sense (rad/s), NED, (3,)."""
        return self._earth

    def correct(self, message: Aiding) -> None:
        """Use a message whose time is the belief's."""
        self.settle()
        suite = self._suite
        match message:
            case AdcpPing():
                ping = self._adcp.linearise(self.belief, message, self.rate)
                self.account["adcp.no_return"] += ping.without_return
                self.account["adcp.outside_grid"] += ping.outside_grid
                self._use("adcp", ping.rows)
            case PressureDepth():
                self._use("pressure", pressure.rows(self.belief, message, suite.pressure))
            case CompassHeading():
                self._use("compass", compass.rows(self.belief, message, suite.compass))
            case GnssFix():
                self._use("gnss", gnss.rows(self.belief, message, suite.gnss))
                self._at_epoch = True
            case TdcpFix():
                if message.from_t_ns == self.belief.epoch_t_ns:
                    self._use("tdcp", tdcp.rows(self.belief, message, suite.tdcp))
                else:
                    self.account["tdcp.other_epoch"] += 2
                self._at_epoch = True

    def _use(self, sensor: str, rows: Rows) -> None:
        if len(rows.residual) == 0:
            return
        correction = correct(self.belief, rows, self._gate)
        used = int(np.count_nonzero(correction.accepted))
        self.account[f"{sensor}.used"] += used
        refused = "gate" if correction.definite else "not_definite"
        self.account[f"{sensor}.{refused}"] += len(rows.residual) - used
