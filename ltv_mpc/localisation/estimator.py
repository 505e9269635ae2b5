"""The estimator node: sensor messages in, one ``Estimate`` per period out.

Screening    rejects messages that are implausible by themselves (``sensor_screening.py``)
Sequencing   applies the others in order of their validity times (``sequencing.py``)
Supervision  reports on the filter once a second, and replaces it if it has diverged (``supervision.py``)
Publishing   an estimate as soon as all that is due at its instant has arrived, at the latest when time continues;
             a checkpoint every 5 s, and when the vehicle submerges or surfaces (``publishing.py``)

A node that receives a checkpoint with its first messages continues from it (``warm_restart.py``); without one it waits
for satellites (``alignment.py``). What arrives after an estimate corrects the next one; nothing is published twice.

The altitude above the bottom follows from the slant ranges of the bottom track. Beam i with the slant range r_i and the
direction u_i (unit vector, NED) finds the bottom at the depth

    d_i = z_transducer + r_i u_i,down

The bottom's depth is the median of the beams that found it, so that one false echo of four does not move it. It is
level between two pings, and for at most ``MAX_AGE_NS`` after the last one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.alignment import Alignment
from ltv_mpc.localisation.filter.checkpoint import belief_of, checkpoint_of, settings_of
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief, grid
from ltv_mpc.localisation.publishing import CheckpointSchedule, EstimateSchedule, estimate
from ltv_mpc.localisation.reinitialisation import is_usable
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensor_screening import SensorScreening
from ltv_mpc.localisation.sensors import BY_MESSAGE, PUBLISHED
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.localisation.sensors.sensor import Measurement
from ltv_mpc.localisation.sequencing import Sequencing
from ltv_mpc.localisation.supervision import Supervision
from ltv_mpc.localisation.warm_restart import WarmRestart
from ltv_mpc.messages import BottomTrack, Estimate, EstimatorState, ImuSample, ImuSamples, LocalisationReport, Message
from ltv_mpc.node import Inbox, OnMessage, Progress, no_progress

MAX_AGE_NS = 3_000_000_000
"""Longest time after a ping for which its bottom counts: several of its periods."""

MIN_BEAMS = 2
"""Smallest number of beams that have found the bottom."""


class Altimeter:
    """Depth of the bottom, from ping to ping."""

    def __init__(self, sensor_config: SensorConfig) -> None:
        """Begin without a bottom.

        Parameters
        ----------
        sensor_config : geometry of the profiler that tracks the bottom.
        """
        adcp = sensor_config.adcp
        self._beams = beam_directions(adcp.beam_angle_rad)
        self._lever_m = np.array(adcp.lever_arm_m)
        self._bottom_m = 0.0
        self._t_ns: int | None = None  # of the last ping that found the bottom

    def receive(self, ping: BottomTrack, belief: Belief) -> None:
        """Take in a ping.

        Parameters
        ----------
        ping : slant ranges (m); NaN: no return.
        belief : the filter's belief, for attitude and depth.
        """
        found = ~np.isnan(ping.range_m)
        if np.count_nonzero(found) < MIN_BEAMS:
            return
        down = (self._beams[found] @ belief.mounting.T @ belief.R.T)[:, 2]
        transducer_m = belief.x[2] + belief.R[2] @ self._lever_m
        self._bottom_m = float(transducer_m + np.median(ping.range_m[found] * down))
        self._t_ns = ping.t_ns

    def altitude_m(self, belief: Belief) -> float | None:
        """Return the height of the vehicle above the bottom (m); None if the bottom is not seen.

        Parameters
        ----------
        belief : the filter's belief, for time and depth.
        """
        if self._t_ns is None or belief.t_ns - self._t_ns > MAX_AGE_NS:
            return None
        return max(self._bottom_m - float(belief.x[2]), 0.0)


class Estimator:
    """ADCP-aided localisation as a node."""

    name = "estimator"
    reads: tuple[type[Message], ...] = tuple(PUBLISHED.values())
    schedule = OnMessage(reads)
    writes: tuple[type[Message], ...] = (Estimate, LocalisationReport, EstimatorState)

    def __init__(
        self,
        sensor_config: SensorConfig,
        config: EstimatorConfig,
        prior: WaterPrior | None = None,
        *,
        progress: Progress = no_progress,
    ) -> None:
        """Create an estimator that waits for its first messages.

        Parameters
        ----------
        sensor_config : settings of the sensors.
        config : settings of the filter.
        prior : water known from an earlier dive; None: that of ``config``.
        progress : called during long computations, as a sign of life.
        """
        self._sensor_config, self._config, self._prior = sensor_config, config, prior
        self._depth_m = grid(config)
        self._settings = settings_of(sensor_config, config, prior)
        self._account: Counter[str] = Counter()  # of the node, and of filters that have been replaced
        self._out: list[Message] = []  # of this step
        self._alignment: Alignment | WarmRestart = Alignment(sensor_config, config, prior)
        self._schedule = EstimateSchedule(sensor_config, config.estimate_period_ns)
        self._checkpoints = CheckpointSchedule()
        self._screening = SensorScreening()
        self._altimeter = Altimeter(sensor_config)
        self._sequencing = Sequencing(self._schedule, self._account, self._publish, progress)
        self._supervision = Supervision(sensor_config, config, prior, self._sequencing, self._account)

    @property
    def filter(self) -> ErrorStateFilter | None:
        """The active filter; None until it is aligned."""
        return self._sequencing.filter

    @property
    def waiting_for(self) -> str:
        """Sensors without which the filter cannot start, as text; empty once it runs."""
        return self._alignment.waiting_for if self.filter is None else ""

    @property
    def account(self) -> Mapping[str, int]:
        """Counts by "<sensor>.<outcome>".

        Scalar measurements: used, deweighted (of these), gate, not_definite, no_return, outside_grid, other_epoch,
        not_fitted, unknown_transponder. Messages: late, late_applied, duplicate, future, stale, stuck, jump,
        without_imu, gap.
        """
        account = Counter(self._account)
        if self.filter is not None:
            account.update(self.filter.account)
        return account

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        """Use every message of the inbox, in its order, at the message's own time.

        Parameters
        ----------
        t_ns : time of the message that caused the step (ns).
        inbox : messages of the sensors, and the state to continue from.
        """
        out = self._out = []
        for received in inbox:
            message = received.message
            if isinstance(message, ImuSamples):
                for sample in message.samples:
                    self._receive(sample, received.received_t_ns)
            elif isinstance(message, EstimatorState):
                self._restore(message)
            else:
                self._receive(message, received.received_t_ns)
        return out

    def _receive(self, message: Any, received_ns: int) -> None:
        """Use a plausible sample or measurement; count one that is not."""
        why = self._screening.rejection(message.t_ns, message, received_ns)
        if why is None:
            self._take(message)
        else:
            self._account[f"{BY_MESSAGE[type(message)].name}.{why}"] += 1

    def _restore(self, state: EstimatorState) -> None:
        """Continue from the state of another process of this node, unless this one has a filter already."""
        if self.filter is not None:
            return
        belief = belief_of(state, self._sensor_config, self._config, self._prior)
        if belief is None:
            self._account["checkpoint.other_settings"] += 1
            return
        self._alignment = WarmRestart(self._sensor_config, self._config, belief, state.estimate)
        self._supervision.reinitialisation.count = state.restarts

    def _take(self, message: ImuSample | Measurement) -> None:
        """Use a message that has passed the screening: for the alignment, then for the filter."""
        if self.filter is not None:
            self._use(message)
            return
        self._alignment.take(message)
        if self._alignment.waiting_for:
            return
        belief, since = self._alignment.belief()
        self._schedule.begin(belief.t_ns)
        self._checkpoints.begin(belief)
        self._supervision.begin(belief, warm=isinstance(self._alignment, WarmRestart))
        for earlier in since:
            self._use(earlier)

    def _use(self, message: ImuSample | Measurement) -> None:
        if type(message) is BottomTrack and self.filter is not None:
            self._altimeter.receive(message, self.filter.belief)
        self._supervision.receive(message)
        self._sequencing.apply(message)
        self._supervision.check()

    def _publish(self, filter_: ErrorStateFilter) -> None:
        """Publish the estimate of the filter's instant, and the report and the checkpoint that are due with it."""
        belief = filter_.belief
        self._schedule.is_open = False
        self._out.append(estimate(filter_, self._depth_m, self._altimeter.altitude_m(belief)))
        if belief.t_ns >= self._supervision.report_ns:
            self._out.append(self._supervision.report(self.account))
        past = self._supervision.reinitialisation
        # A restart must not continue from an inconsistent filter.
        saves = self._config.is_saved and not past.is_inconsistent and is_usable(belief)
        if saves and self._checkpoints.is_due(belief):
            self._checkpoints.advance(belief)
            self._out.append(checkpoint_of(filter_, self._settings, past.count))
