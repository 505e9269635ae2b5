"""Sequencing of measurements in time: which message is used, at which instant, and in which order.

Order     Measurements are applied in order of validity time. A measurement newer than the last inertial sample waits
          for the sample that covers it, which is then split at the measurement's time.
Late      A measurement older than the filter is applied at its own time if it is at most ``REACH_NS`` old
          (``out_of_sequence.py``). Older measurements and late inertial samples are dropped (``imu_dropout.py``
          describes how the filter bridges missing samples).
Duplicate A second message of the same sensor and validity time is dropped.
"""

from __future__ import annotations

import bisect
from collections import Counter
from collections.abc import Callable, Sequence

from ltv_mpc.localisation import imu_dropout
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.out_of_sequence import MeasurementBuffer
from ltv_mpc.localisation.publishing import EstimateSchedule
from ltv_mpc.localisation.reinitialisation import is_finite
from ltv_mpc.localisation.sensors import BY_MESSAGE
from ltv_mpc.localisation.sensors.sensor import Measurement
from ltv_mpc.localisation.shadow_filter import ShadowFilter
from ltv_mpc.messages import AdcpPing, ImuSample
from ltv_mpc.node import Progress

_MAX_WAITING = 1000
"""Maximum number of measurements that wait for an inertial sample. Beyond it the inertial unit has failed, and the
oldest measurement is dropped."""


class Sequencing:
    """Applies samples and measurements to the active filter in order of their validity times.

    ``shadow`` is None, or a second filter that receives the same samples and measurements.
    """

    def __init__(
        self,
        schedule: EstimateSchedule,
        account: Counter[str],
        publish: Callable[[ErrorStateFilter], None],
        progress: Progress,
    ) -> None:
        """Create a sequencing without a filter.

        Parameters
        ----------
        schedule : instants of the estimates; the filter stops at each of them.
        account : counts by "<sensor>.<outcome>", updated in place.
        publish : called with the filter when it stands at an estimate's instant and the estimate is complete.
        progress : called with every propagation step, as a sign of life.
        """
        self.shadow: ShadowFilter | None = None
        self._schedule = schedule
        self._account = account
        self._publish = publish
        self._progress = progress
        self._buffer: MeasurementBuffer | None = None
        # Measurements that wait for the inertial sample that covers them, by time, then order of arrival.
        self._waiting: list[Measurement] = []

    @property
    def filter(self) -> ErrorStateFilter | None:
        """The active filter; None until one has been set."""
        return None if self._buffer is None else self._buffer.filter

    def set_filter(self, filter_: ErrorStateFilter) -> None:
        """Make ``filter_`` the active filter, with an empty buffer of past measurements.

        Parameters
        ----------
        filter_ : the filter that all further messages are applied to.
        """
        self._buffer = MeasurementBuffer(filter_, self._progress)

    def apply(self, message: ImuSample | Measurement) -> None:
        """Apply one message to the filter, or store it until the inertial sample that covers it.

        Parameters
        ----------
        message : an inertial sample, or a measurement of any validity time.
        """
        buffer = self._required()
        if isinstance(message, ImuSample):
            self._propagate(buffer, message)
            return
        now_ns, sensor = buffer.filter.belief.t_ns, BY_MESSAGE[type(message)].name
        if message.t_ns > now_ns:
            bisect.insort(self._waiting, message, key=lambda m: m.t_ns)
            if len(self._waiting) > _MAX_WAITING:
                self._account[f"{BY_MESSAGE[type(self._waiting.pop(0))].name}.without_imu"] += 1
        elif message.t_ns == now_ns:
            self._correct(buffer, message)
        elif not buffer.is_within_reach(message.t_ns):
            self._account[f"{sensor}.late"] += 1
        elif buffer.contains(message):
            self._account[f"{sensor}.duplicate"] += 1
        elif is_finite(buffer.filter.belief):
            self._use(buffer, message)
            self._account[f"{sensor}.late_applied"] += 1

    def reapply(self, messages: Sequence[ImuSample | Measurement]) -> None:
        """Apply past messages to a new filter without publishing an estimate on the way.

        Parameters
        ----------
        messages : before the next estimate, in the order in which they were first applied.
        """
        was_open, self._schedule.is_open = self._schedule.is_open, False
        for message in messages:
            self.apply(message)
        self._schedule.is_open = was_open

    def _required(self) -> MeasurementBuffer:
        assert self._buffer is not None, "set_filter() must be called first"
        return self._buffer

    def _propagate(self, buffer: MeasurementBuffer, sample: ImuSample) -> None:
        """Propagate to the sample's time; stop at every waiting measurement and every estimate on the way."""
        filter_ = buffer.filter
        if sample.t_ns <= filter_.belief.t_ns:
            self._account["imu.late"] += 1
            return
        if imu_dropout.gap_before_ns(sample, filter_.belief.t_ns):
            self._account["imu.gap"] += 1
        while filter_.belief.t_ns < sample.t_ns:
            stop_ns = min(sample.t_ns, self._schedule.next_ns)
            if self._waiting:
                stop_ns = min(stop_ns, self._waiting[0].t_ns)
            if self._schedule.is_open:  # time continues: a message that is still awaited corrects the next estimate
                self._publish(filter_)
            buffer.advance(stop_ns, sample)
            if self.shadow is not None:
                self.shadow.advance(stop_ns, sample)
            self._schedule.reach(stop_ns)
            while self._waiting and self._waiting[0].t_ns == stop_ns:
                self._correct(buffer, self._waiting.pop(0))
            if self._schedule.is_complete:
                self._publish(filter_)

    def _correct(self, buffer: MeasurementBuffer, message: Measurement) -> None:
        """Correct by a measurement of the filter's own instant."""
        if buffer.contains(message):
            self._account[f"{BY_MESSAGE[type(message)].name}.duplicate"] += 1
            return
        if is_finite(buffer.filter.belief):
            self._use(buffer, message)
        self._schedule.receive(type(message))
        if self._schedule.is_complete:
            self._publish(buffer.filter)

    def _use(self, buffer: MeasurementBuffer, message: Measurement) -> None:
        """Correct both filters at the message's own time; after a ping, adapt the water's process noise."""
        buffer.use(message)
        if isinstance(message, AdcpPing):
            buffer.adapt()
        if self.shadow is not None:
            self.shadow.use(message)
