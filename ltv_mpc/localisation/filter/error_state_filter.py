"""The error-state Kalman filter: one belief of vehicle and water, moved by the inertial unit, corrected by the rest.

Between two corrections the estimate is integrated sample by sample and only the core's transition is gathered
(``preintegration.py``); ``propagate_covariance`` then moves the large covariance once:
    P_cc := Phi P_cc Phi^T + Q,  P_cr := Phi P_cr      c: the fifteen core states, r: all others
Biases and water cells behind the core are constants, first-order Gauss-Markov or random walks.
The vehicle's dynamic model is not fused: what the thrusters do is no evidence here.
"""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from ltv_mpc.frames import earth_rate
from ltv_mpc.localisation import imu_dropout
from ltv_mpc.localisation.adaptive.failure_signatures import FailureSignatures
from ltv_mpc.localisation.adaptive.glr_detector import COLUMNS
from ltv_mpc.localisation.adaptive.process_noise import AdaptiveProcessNoise
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.correction import Correction, correct
from ltv_mpc.localisation.filter.preintegration import imu_noise, integrate, propagate, propagated_core, sample_matrix
from ltv_mpc.localisation.filter.state import CORE, GYRO_BIAS, Belief, reach_m
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import BY_MESSAGE
from ltv_mpc.localisation.sensors.adcp import LinearisedPing
from ltv_mpc.localisation.sensors.rows import Indices, Linearised
from ltv_mpc.localisation.sensors.sensor import AnySensor, Availability, Context, Measurement
from ltv_mpc.localisation.water import current_model
from ltv_mpc.localisation.water.grid_window import move_window
from ltv_mpc.messages import AdcpPing, Array, ImuSample

_MAX_DEWEIGHTED = 36.0
"""Squared innovation over its variance up to which an outlier of a sensor at the surface is de-weighted instead of
rejected: six deviations. Half a wave of carrier phase, 95 mm, is more, even if the velocity is known by the receiver
alone (15 mm)."""


class Innovations(NamedTuple):
    """What came of one message: the innovations as they stood before the gate, and which of them passed it."""

    sensor: str
    t_ns: int
    indices: Indices  # (m,), of each row in its message; of a profiler's: beam x cells + cell
    residual: Array  # (m,)
    S: Array  # (m, m), innovation covariance
    accepted: npt.NDArray[np.bool_]  # (m,)
    definite: bool = True  # S was positive definite; if not, nothing was accepted


class Snapshot(NamedTuple):
    """All of a filter that changes with time, copied; its account and who observes it do not belong to it."""

    belief: Belief
    angular_rate_radps: tuple[float, float, float]
    Phi: Array
    Q: Array
    pending_ns: int
    at_epoch: bool
    coasted_ns: int
    process_noise: AdaptiveProcessNoise


class ErrorStateFilter:
    """``belief`` stands at ``belief.t_ns``; its covariance only after ``propagate_covariance``."""

    def __init__(
        self, suite: SensorConfig, config: EstimatorConfig, belief: Belief, *, adapts_from_ns: int | None = None
    ) -> None:
        """``adapts_from_ns``: from then on water may change in unforeseen ways; None: from the beginning."""
        self.belief = belief
        self.angular_rate_radps: tuple[float, float, float] = (
            0.0,
            0.0,
            0.0,
        )  # measured last (rad/s, body, bias included)
        self.account: Counter[str] = Counter()  # scalar measurements by "<sensor>.<what came of them>"
        self.observers: list[Callable[[Innovations], None]] = []  # told of every message, once
        self._suite = suite
        self._config = config
        self._gate = float(chdtri(1, 1.0 - config.gate_probability))  # quantile of chi-square, 1 degree of freedom
        self._reach_m = reach_m(suite.adcp)
        self._noise = imu_noise(suite.imu)
        self._earth = earth_rate(suite.latitude_rad) if suite.imu.senses_earth_rate else np.zeros(3)
        self._Phi = np.eye(CORE)
        self._Q = np.zeros((CORE, CORE))
        self._pending_ns = 0
        self.process_noise = AdaptiveProcessNoise(
            config.cell_m, belief.t_ns if adapts_from_ns is None else adapts_from_ns
        )
        if config.adapts_to_water:
            belief.signatures = FailureSignatures.of(belief.layout.size, COLUMNS)
        self._coasted_ns = 0  # over the gap that it is in
        self._at_epoch = False  # a satellite fix came at this instant: its position is cloned when time goes on

    def advance(self, t_ns: int, sample: ImuSample) -> None:
        """Move to ``t_ns`` with the rates of ``sample``; over what they do not cover, as ``imu_dropout.py`` has it."""
        belief = self.belief
        if self._at_epoch:
            self._at_epoch = False
            self.propagate_covariance()
            belief.clone_position(self._suite.gnss.lever_arm_m)
        gap_ns = imu_dropout.gap_before_ns(sample, belief.t_ns)
        if self._coasted_ns and gap_ns <= imu_dropout.MAX_BRIDGED_NS:
            if self._coasted_ns >= imu_dropout.MIN_LEVELLED_NS:
                self.propagate_covariance()
                correct(belief, imu_dropout.level(belief, sample.specific_force_mps2), math.inf)
            self._coasted_ns = 0
        if gap_ns:
            self._cross(min(t_ns, belief.t_ns + gap_ns), sample, gap_ns)
        if belief.t_ns < t_ns:
            self._integrate([t_ns], [sample], sample_matrix([sample]))

    def count_contiguous(self, samples: Sequence[ImuSample], until_ns: int) -> int:
        """How many of these samples, from the first on, only integration follows: each goes on where the last ended,
        and starts before ``until_ns``.
        """
        now_ns = self.belief.t_ns
        if self._at_epoch or self._coasted_ns:
            return 0
        for number, sample in enumerate(samples):
            t_ns = sample.t_ns
            goes_on = t_ns > now_ns and (
                t_ns - sample.interval_ns == now_ns or not imu_dropout.gap_before_ns(sample, now_ns)
            )
            if now_ns >= until_ns or not goes_on:
                return number
            now_ns = t_ns
        return len(samples)

    def advance_batch(self, samples: Sequence[ImuSample], measured: Array) -> int:
        """``advance`` to the time of each of samples that follow, ``measured`` (K, 6), and none beyond one after which
        the belief is not finite; how many.
        """
        return self._integrate([sample.t_ns for sample in samples], samples, measured)

    def _integrate(self, until_ns: Sequence[int], samples: Sequence[ImuSample], measured: Array) -> int:
        """By each sample until its time, as ``preintegration.integrate`` has it; how many."""
        belief = self.belief
        stamps_ns = np.array([belief.t_ns, *until_ns])
        seconds = 1e-9 * (stamps_ns[1:] - stamps_ns[:-1])
        done = integrate(belief.x, belief.R, self._Phi, self._Q, measured, seconds, self._noise, self._earth)
        self.angular_rate_radps = samples[done - 1].angular_rate_radps
        self._pending_ns += until_ns[done - 1] - belief.t_ns
        belief.t_ns = until_ns[done - 1]
        return done

    def _cross(self, t_ns: int, sample: ImuSample, gap_ns: int) -> None:
        """To ``t_ns``, within the ``gap_ns`` before ``sample`` of which nothing was measured."""
        belief = self.belief
        seconds, gap_s = (t_ns - belief.t_ns) * 1e-9, gap_ns * 1e-9
        if gap_ns <= imu_dropout.MAX_BRIDGED_NS:
            self._integrate([t_ns], [sample], sample_matrix([sample]))
            imu_dropout.inflate(self._Q, seconds, gap_s)
            return
        down = belief.R[2]
        turns = [
            float(down @ (np.array(rate) - belief.x[GYRO_BIAS]))
            for rate in (self.angular_rate_radps, sample.angular_rate_radps)
        ]
        imu_dropout.coast(belief.x, belief.R, self._Phi, self._Q, seconds, gap_s, 0.5 * sum(turns), self._suite.imu)
        self._pending_ns += t_ns - belief.t_ns
        self._coasted_ns += t_ns - belief.t_ns
        belief.t_ns = t_ns

    def snapshot(self) -> Snapshot:
        """Where it stands, to come back to."""
        belief = self.belief.copy()
        Phi, Q = self._Phi.copy(), self._Q.copy()
        pending_ns, coasted_ns = self._pending_ns, self._coasted_ns
        return Snapshot(
            belief, self.angular_rate_radps, Phi, Q, pending_ns, self._at_epoch, coasted_ns, self.process_noise.copy()
        )

    def restore(self, then: Snapshot) -> None:
        """Back to where it stood, bit for bit; ``then`` can be restored again."""
        self.belief = then.belief.copy()
        self.angular_rate_radps = then.angular_rate_radps
        self._Phi, self._Q = then.Phi.copy(), then.Q.copy()
        self._pending_ns, self._coasted_ns, self._at_epoch = then.pending_ns, then.coasted_ns, then.at_epoch
        self.process_noise = then.process_noise.copy()

    def propagate_covariance(self) -> None:
        """Bring the whole covariance to the belief's time."""
        if self._pending_ns == 0:
            return
        belief, dt = self.belief, self._pending_ns * 1e-9
        P, E = belief.P, belief.signatures.error
        propagate(P, E, self._Phi, self._Q)
        bias = belief.layout.compass_bias
        if bias.stop > bias.start:
            keep = math.exp(-dt / self._suite.compass.bias_tau_s)
            belief.x[bias] *= keep
            E[bias] *= keep
            P[bias, :] *= keep
            P[:, bias] *= keep
            P[bias, bias] += self._suite.compass.bias_sd_rad**2 * (1.0 - keep * keep)
        current_model.add_random_walk(belief, self._config, dt)
        self.process_noise.propagate(belief, dt)
        self._pending_ns = 0

    def propagated_belief(self) -> Belief:
        """A copy of the belief with its whole covariance at its time; the filter itself stays as it is, bit for bit."""
        other = self.fork()
        other.propagate_covariance()
        return other.belief

    def fork(self) -> ErrorStateFilter:
        """Another that stands where this one does; its account is empty and nobody observes it."""
        other = copy.copy(self)
        other.belief, other.process_noise = self.belief.copy(), self.process_noise.copy()
        other._Phi, other._Q = self._Phi.copy(), self._Q.copy()
        other.account, other.observers = Counter(), []
        return other

    def core_covariance(self) -> Array:
        """Of the core at the belief's time, (15, 15), without moving the rest."""
        return propagated_core(self.belief.P, self._Phi, self._Q)

    @property
    def angular_rate_variance(self) -> float:
        """Of one axis of ``rate`` less its bias (rad2/s2): the angle random walk over one sample."""
        imu = self._suite.imu
        return imu.angle_random_walk_rad_per_rts**2 / (imu.period_ns * 1e-9)

    @property
    def earth_rate_radps(self) -> Array:
        """That the gyros sense (rad/s), NED, (3,)."""
        return self._earth

    def correct(self, message: Measurement) -> None:
        """Correct by a measurement of the belief's time.

        Parameters
        ----------
        message : measurement of any sensor of the registry; it is counted only, if the vehicle lacks the sensor.
        """
        self.propagate_covariance()
        belief, sensor = self.belief, BY_MESSAGE[type(message)]
        move_window(belief, *self._reach_m, self._config.cell_m)
        settings = getattr(self._suite, sensor.name)
        if settings is None or sensor.linearise is None:
            self.account[f"{sensor.name}.not_fitted"] += sensor.scalars
            return
        if isinstance(message, AdcpPing):
            self.process_noise.start_ping(belief)
        context = Context(self._suite, self._config.cell_m, self.angular_rate_radps)
        linearised = sensor.linearise(belief, message, settings, context)
        correction = self._use(sensor, linearised)
        if correction is not None and isinstance(linearised, LinearisedPing) and isinstance(message, AdcpPing):
            self._observe_water(linearised, correction, len(message.range_m))
        self._at_epoch |= sensor.clones_position

    def _observe_water(self, ping: LinearisedPing, correction: Correction, cells: int) -> None:
        """Mark the grid points that a ping has measured, and give its innovations to the adaptation."""
        self.belief.column.mark_observed(ping.grid_points[correction.accepted])
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
        deweighted = _MAX_DEWEIGHTED if sensor.availability is Availability.SURFACE else 0.0
        correction = correct(self.belief, rows, self._gate, deweighted)
        used = int(np.count_nonzero(correction.accepted)) + correction.deweighted
        self.account[f"{name}.used"] += used
        refused = "gate" if correction.definite else "not_definite"
        if correction.deweighted:
            self.account[f"{name}.deweighted"] += correction.deweighted
        self.account[f"{name}.{refused}"] += len(rows.residual) - used
        if self.observers:
            indices = linearised.indices
            verdict = Innovations(
                sensor=name,
                t_ns=self.belief.t_ns,
                indices=np.arange(len(rows.residual)) if indices is None else indices,
                residual=rows.residual,
                S=correction.S,
                accepted=correction.accepted,
                definite=correction.definite,
            )
            for observer in self.observers:
                observer(verdict)
        return correction
