"""Error-state Kalman filter of vehicle and water: propagated by the IMU, corrected by all other sensors.

Between two corrections the estimate is integrated sample by sample, and only the transition of the core states
accumulates (``strapdown.py``). ``propagate_covariance`` then propagates the full covariance once:
    P_cc := Phi P_cc Phi^T + Q,  P_cr := Phi P_cr      c: the fifteen core states, r: all others
The states behind the core are constants, first-order Gauss-Markov processes or random walks.
The vehicle's dynamic model is not fused: thruster commands are no evidence of motion here.
Source  Groves 2013, chapters 3 and 14.
"""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from ltv_mpc.frames import earth_rate
from ltv_mpc.localisation import current_model, imu_dropout
from ltv_mpc.localisation.adaptive.failure_signatures import FailureSignatures
from ltv_mpc.localisation.adaptive.glr_detector import COLUMNS
from ltv_mpc.localisation.adaptive.process_noise import AdaptiveProcessNoise
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import CORE, GYRO_BIAS, Belief
from ltv_mpc.localisation.filter.strapdown import imu_noise, integrate, propagate, propagated_core
from ltv_mpc.localisation.filter.update import Correction, correct
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import BY_MESSAGE
from ltv_mpc.localisation.sensors.adcp import LinearisedPing
from ltv_mpc.localisation.sensors.sensor import AnySensor, Availability, Context, Indices, Linearised, Measurement
from ltv_mpc.messages import AdcpPing, Array, ImuSample, Triple

_DEWEIGHT_LIMIT = 36.0
"""Largest squared normalised innovation of a surface sensor's row that is de-weighted instead of rejected: six standard
deviations. Half a wavelength of carrier phase, 95 mm, is more, even if only the receiver knows the velocity (15 mm).
"""


class Innovations(NamedTuple):
    """Innovations of one message before the gate, and the rows that passed it."""

    sensor: str
    t_ns: int
    indices: Indices  # (m,), position of each row in its message; ADCP: beam x cells + cell
    residual: Array  # (m,)
    S: Array  # (m, m), innovation covariance
    accepted: npt.NDArray[np.bool_]  # (m,)
    definite: bool = True  # S was positive definite; if not, no row was accepted


@dataclass(slots=True, kw_only=True)
class FilterState:
    """Everything in a filter that changes with time, except its counts and observers."""

    belief: Belief
    process_noise: AdaptiveProcessNoise
    angular_rate_radps: Triple  # last measured, FRD, bias included
    Phi: Array = field(default_factory=lambda: np.eye(CORE))  # core transition since the covariance was propagated
    Q: Array = field(default_factory=lambda: np.zeros((CORE, CORE)))  # process noise over the same time
    pending_ns: int = 0  # time since the covariance was propagated
    coasted_ns: int = 0  # time coasted in the present IMU dropout
    clones_position: bool = False  # a satellite epoch is at this instant: clone the position before advancing

    def copy(self) -> FilterState:
        """Return an independent copy."""
        return replace(
            self,
            belief=self.belief.copy(),
            process_noise=copy.deepcopy(self.process_noise),
            Phi=self.Phi.copy(),
            Q=self.Q.copy(),
        )


class ErrorStateFilter:
    """Error-state Kalman filter of vehicle and water.

    The estimate always stands at ``belief.t_ns``. Its covariance stands there only after ``propagate_covariance``.

    Parameters
    ----------
    sensor_config : settings of the sensors.
    config : settings of the estimator.
    belief : first estimate.
    adapts_from_ns : the process noise of the water adapts from this time on; None: from the time of ``belief``.
    angular_rate_radps : angular rate (FRD, bias included) before the first sample, if a gap comes before that.
    """

    def __init__(
        self,
        sensor_config: SensorConfig,
        config: EstimatorConfig,
        belief: Belief,
        *,
        adapts_from_ns: int | None = None,
        angular_rate_radps: Triple = (0.0, 0.0, 0.0),
    ) -> None:
        self.account: Counter[str] = Counter()  # scalar measurements by "<sensor>.<outcome>"
        self.observers: list[Callable[[Innovations], None]] = []  # called once for every message
        self._sensor_config = sensor_config
        self._config = config
        self._gate = float(chdtri(1, 1.0 - config.gate_probability))  # quantile of chi-square, 1 degree of freedom
        self._noise = imu_noise(sensor_config.imu)
        senses = sensor_config.imu.senses_earth_rate
        self.earth_rate_radps = earth_rate(sensor_config.latitude_rad) if senses else np.zeros(3)
        """Earth rate that the gyros sense (rad/s, NED), (3,); zero if they do not sense it."""
        from_ns = belief.t_ns if adapts_from_ns is None else adapts_from_ns
        process_noise = AdaptiveProcessNoise(config.cell_m, from_ns)
        self._state = FilterState(belief=belief, process_noise=process_noise, angular_rate_radps=angular_rate_radps)
        if config.adapts_to_water:
            belief.signatures = FailureSignatures.of(belief.layout.size, COLUMNS)

    @property
    def belief(self) -> Belief:
        """State estimate with covariance."""
        return self._state.belief

    @property
    def process_noise(self) -> AdaptiveProcessNoise:
        """Adaptive process noise of the water."""
        return self._state.process_noise

    @property
    def angular_rate_radps(self) -> Triple:
        """Angular rate measured last (rad/s, FRD), bias included."""
        return self._state.angular_rate_radps

    @property
    def angular_rate_variance(self) -> float:
        """Variance of one axis of the bias-free angular rate (rad2/s2): the angle random walk over one sample."""
        imu = self._sensor_config.imu
        return imu.angle_random_walk_rad_per_rts**2 / (imu.period_ns * 1e-9)

    def advance(self, t_ns: int, sample: ImuSample) -> None:
        """Propagate the estimate to a time; ``imu_dropout.py`` covers the time before the sample.

        Parameters
        ----------
        t_ns : time to reach, at most that of ``sample``.
        sample : IMU sample that contains ``t_ns``, or the first one after an IMU dropout.
        """
        state, belief = self._state, self.belief
        if state.clones_position:
            state.clones_position = False
            self.propagate_covariance()
            belief.clone_position(self._sensor_config.gnss.lever_arm_m)
        gap_ns = imu_dropout.gap_before_ns(sample, belief.t_ns)
        if state.coasted_ns and gap_ns <= imu_dropout.MAX_BRIDGED_NS:
            if state.coasted_ns >= imu_dropout.MIN_LEVELLED_NS:
                self.propagate_covariance()
                correct(belief, imu_dropout.level(belief, sample.specific_force_mps2), math.inf)
            state.coasted_ns = 0
        if gap_ns:
            self._cross_gap(min(t_ns, belief.t_ns + gap_ns), sample, gap_ns)
        if belief.t_ns < t_ns:
            self._integrate(t_ns, sample)

    def _integrate(self, t_ns: int, sample: ImuSample) -> None:
        """Integrate a sample from the time of the belief to ``t_ns``."""
        state, belief = self._state, self.belief
        measured = np.array((*sample.angular_rate_radps, *sample.specific_force_mps2))
        seconds = 1e-9 * (t_ns - belief.t_ns)
        integrate(belief.x, belief.R, state.Phi, state.Q, measured, seconds, self._noise, self.earth_rate_radps)
        state.angular_rate_radps = sample.angular_rate_radps
        state.pending_ns += t_ns - belief.t_ns
        belief.t_ns = t_ns

    def _cross_gap(self, t_ns: int, sample: ImuSample, gap_ns: int) -> None:
        """Propagate to ``t_ns`` within a gap, of which ``gap_ns`` is left before ``sample``: nothing was measured."""
        state, belief = self._state, self.belief
        seconds, gap_s = (t_ns - belief.t_ns) * 1e-9, (state.coasted_ns + gap_ns) * 1e-9
        if gap_ns <= imu_dropout.MAX_BRIDGED_NS:
            self._integrate(t_ns, sample)
            imu_dropout.inflate(state.Q, seconds, gap_s)
            return
        down = belief.R[2]
        turns = [
            float(down @ (np.array(rate) - belief.x[GYRO_BIAS]))
            for rate in (state.angular_rate_radps, sample.angular_rate_radps)
        ]
        imu_dropout.coast(
            belief.x, belief.R, state.Phi, state.Q, seconds, gap_s, 0.5 * sum(turns), self._sensor_config.imu
        )
        state.pending_ns += t_ns - belief.t_ns
        state.coasted_ns += t_ns - belief.t_ns
        belief.t_ns = t_ns

    def snapshot(self) -> FilterState:
        """Return a copy of everything that changes with time, for ``restore``."""
        return self._state.copy()

    def restore(self, then: FilterState) -> None:
        """Return to a snapshot, bitwise. The snapshot stays valid.

        Parameters
        ----------
        then : state from ``snapshot``.
        """
        self._state = then.copy()

    def propagate_covariance(self) -> None:
        """Propagate the full covariance to the time of the belief."""
        state, belief = self._state, self.belief
        if state.pending_ns == 0:
            return
        dt = state.pending_ns * 1e-9
        propagate(belief.P, belief.signatures.error, state.Phi, state.Q)
        compass = self._sensor_config.compass
        belief.propagate_bias(belief.layout.compass_bias, compass.bias_sd_rad, compass.bias_tau_s, dt)
        current_model.add_random_walk(belief, self._config, dt)
        state.process_noise.propagate(belief, dt)
        state.pending_ns = 0

    def propagated_belief(self) -> Belief:
        """Return a copy of the belief with its full covariance at its time. The filter does not change."""
        other = self.fork()
        other.propagate_covariance()
        return other.belief

    def fork(self) -> ErrorStateFilter:
        """Return an independent filter in the same state, with empty counts and without observers."""
        other = copy.copy(self)
        other._state = self._state.copy()
        other.account, other.observers = Counter(), []
        return other

    def core_covariance(self) -> Array:
        """Return the covariance of the core states at the time of the belief, (15, 15). The filter does not change."""
        return propagated_core(self.belief.P, self._state.Phi, self._state.Q)

    def correct(self, message: Measurement) -> None:
        """Correct by a measurement of the belief's time.

        Parameters
        ----------
        message : measurement of any sensor of the registry; if the vehicle lacks the sensor, it is only counted.
        """
        self.propagate_covariance()
        belief, sensor = self.belief, BY_MESSAGE[type(message)]
        settings = getattr(self._sensor_config, sensor.name)
        if settings is None or sensor.linearise is None:
            self.account[f"{sensor.name}.not_fitted"] += sensor.scalars_per_message
            return
        if isinstance(message, AdcpPing):
            self.process_noise.start_ping(belief)
        context = Context(self._sensor_config, self._config.cell_m, self.angular_rate_radps)
        linearised = sensor.linearise(belief, message, settings, context)
        correction = self._use(sensor, linearised)
        if correction is not None and isinstance(linearised, LinearisedPing) and isinstance(message, AdcpPing):
            self._observe_water(linearised, correction, len(message.range_m))
        self._state.clones_position |= sensor.clones_position

    def _observe_water(self, ping: LinearisedPing, correction: Correction, cells: int) -> None:
        """Give the innovations of a ping and its correction to the adaptive process noise."""
        if self._config.adapts_to_water and correction.definite and ping.indices is not None:
            r, S = ping.rows.residual, correction.S
            self.process_noise.add_innovations(self.belief.t_ns, ping.beams, ping.indices % cells, r, S)
            self.process_noise.add_correction(self.belief, ping.grid_points, correction.error)

    def _use(self, sensor: AnySensor, linearised: Linearised) -> Correction | None:
        """Correct by the rows of one message and count them; return None if there are none."""
        name, rows = sensor.name, linearised.rows
        for reason, count in linearised.unused.items():
            self.account[f"{name}.{reason}"] += count
        if len(rows.residual) == 0:
            return None
        deweight_limit = _DEWEIGHT_LIMIT if sensor.availability is Availability.SURFACE else 0.0
        correction = correct(self.belief, rows, self._gate, deweight_limit)
        used = int(np.count_nonzero(correction.accepted)) + correction.deweighted
        self.account[f"{name}.used"] += used
        refused = "gate" if correction.definite else "not_definite"
        if correction.deweighted:
            self.account[f"{name}.deweighted"] += correction.deweighted
        self.account[f"{name}.{refused}"] += len(rows.residual) - used
        if self.observers:
            indices = np.arange(len(rows.residual)) if linearised.indices is None else linearised.indices
            accepted, definite = correction.accepted, correction.definite
            innovations = Innovations(name, self.belief.t_ns, indices, rows.residual, correction.S, accepted, definite)
            for observer in self.observers:
                observer(innovations)
        return correction
