"""The estimator node: sensor messages in, one ``Estimate`` per period out.

Order   Messages are used in order of their validity times. One that is newer than the last inertial sample waits for
        the sample that covers it, which is then split there; one older than the belief is counted and dropped.
Output  An estimate of t_ns = k x period holds everything measured up to and at t_ns: it is published as soon as all
        that the sensors file has due at t_ns has come, at the latest when time goes on.
"""

from __future__ import annotations

import bisect
import math
from collections import Counter
from collections.abc import Mapping

import numpy as np

from ltv_mpc.frames import roll_pitch_heading
from ltv_mpc.localisation import water_column
from ltv_mpc.localisation.alignment import Alignment
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter import Aiding, Filter
from ltv_mpc.localisation.measurements.compass import heading_partials
from ltv_mpc.localisation.state import ATTITUDE, CORE, GYRO_BIAS, grid
from ltv_mpc.localisation.suite import Suite
from ltv_mpc.node import Inbox, OnMessage
from ltv_mpc.signals import (
    AdcpPing,
    CompassHeading,
    Estimate,
    GnssFix,
    ImuSample,
    PressureDepth,
    Signal,
    TdcpFix,
)

_SENSORS = (ImuSample, GnssFix, TdcpFix, AdcpPing, PressureDepth, CompassHeading)

_MOST_WAITING = 1000
"""Messages that wait for an inertial sample; beyond, the oldest is dropped: the unit has failed."""


def estimate(filter_: Filter, depth_m: np.typing.NDArray[np.float64]) -> Estimate:
    """What is published of a filter, at its belief's time. ``depth_m`` is the water's grid."""
    belief = filter_.belief
    roll, pitch, heading = roll_pitch_heading(belief.R)
    # w = w_m - b_g - R^T W against NED, body axes;  heading rate = (w_y sin roll + w_z cos roll) / cos pitch
    w = np.array(filter_.rate) - belief.x[GYRO_BIAS] - belief.R.T @ filter_.rotation_of_earth
    to_yaw = np.array([0.0, math.sin(roll), math.cos(roll)]) / math.cos(pitch)

    J = np.zeros((6, CORE))
    J[0, 0] = J[1, 1] = J[2, 3] = J[3, 4] = 1.0
    J[4, ATTITUDE] = heading_partials(belief.R)
    J[5, GYRO_BIAS] = -to_yaw
    covariance = J @ filter_.core_covariance() @ J.T
    covariance[5, 5] += filter_.rate_variance * float(to_yaw @ to_yaw)
    north, east, down, v_north, v_east, v_down = belief.x[:6].tolist()
    return Estimate(
        t_ns=belief.t_ns,
        north_m=north,
        east_m=east,
        heading_rad=heading,
        yaw_rate_radps=float(to_yaw @ w),
        velocity_north_mps=v_north,
        velocity_east_mps=v_east,
        depth_m=down,
        velocity_down_mps=v_down,
        covariance=0.5 * (covariance + covariance.T),
        current=water_column.profile(belief, depth_m),
    )


class Estimator:
    """ADCP-aided localisation as a node."""

    name = "estimator"
    schedule = OnMessage(_SENSORS)
    reads: tuple[type[Signal], ...] = _SENSORS
    writes: tuple[type[Signal], ...] = (Estimate,)

    def __init__(self, suite: Suite, config: EstimatorConfig) -> None:
        self._suite = suite
        self._period_ns = config.estimate_period_ns
        self._config = config
        self._depth_m = grid(config)
        self._alignment = Alignment(suite, config)
        self._filter: Filter | None = None
        self._waiting: list[Aiding] = []  # for the inertial sample that covers them, by time, then arrival
        self._next_ns = 0  # of the estimate to come
        self._awaited: list[type[Signal]] = []  # due at this instant and not here yet, while its estimate is open
        self._open = False  # this instant's estimate is still to be published
        self._account: Counter[str] = Counter()

    @property
    def filter(self) -> Filter | None:
        """None until it is aligned."""
        return self._filter

    @property
    def waiting_for(self) -> str:
        """Sensors without which it cannot start, in words; empty once it runs."""
        return self._alignment.waiting_for if self._filter is None else ""

    @property
    def account(self) -> Mapping[str, int]:
        """Scalar measurements by "<sensor>.<what came of them>": used, gate, no_return, late, ..."""
        return self._account if self._filter is None else self._account + self._filter.account

    def step(self, t_ns: int, inbox: Inbox) -> list[Signal]:  # noqa: ARG002  (each message carries its own time)
        """Use every message of the inbox in its order."""
        out: list[Signal] = []
        for arrival in inbox:
            if isinstance(arrival.signal, _SENSORS):
                self._take(arrival.signal, out)
        return out

    def _take(self, message: ImuSample | Aiding, out: list[Signal]) -> None:
        if self._filter is not None:
            self._use(self._filter, message, out)
            return
        self._alignment.take(message)
        if self._alignment.waiting_for:
            return
        belief, since = self._alignment.belief()
        self._filter = Filter(self._suite, self._config, belief)
        self._next_ns = (belief.t_ns // self._period_ns + 1) * self._period_ns
        for earlier in since:
            self._use(self._filter, earlier, out)

    def _use(self, filter_: Filter, message: ImuSample | Aiding, out: list[Signal]) -> None:
        if isinstance(message, ImuSample):
            self._move(filter_, message, out)
        elif message.t_ns < filter_.belief.t_ns:
            self._account[f"{type(message).__name__}.late"] += 1
        elif message.t_ns > filter_.belief.t_ns:
            bisect.insort(self._waiting, message, key=lambda m: m.t_ns)
            if len(self._waiting) > _MOST_WAITING:
                self._account[f"{type(self._waiting.pop(0)).__name__}.without_imu"] += 1
        else:
            self._correct(filter_, message, out)

    def _move(self, filter_: Filter, sample: ImuSample, out: list[Signal]) -> None:
        """Advance to the sample's time, by way of every message and every estimate that falls within."""
        belief = filter_.belief
        if sample.t_ns <= belief.t_ns:
            self._account["ImuSample.late"] += 1
            return
        if sample.t_ns - sample.interval_ns > belief.t_ns:
            self._account["ImuSample.gap"] += 1  # bridged with this sample's rates
        while belief.t_ns < sample.t_ns:
            stop_ns = min(sample.t_ns, self._next_ns)
            if self._waiting:
                stop_ns = min(stop_ns, self._waiting[0].t_ns)
            self._publish(filter_, out)
            filter_.advance(stop_ns, sample)
            if stop_ns == self._next_ns:
                self._open = True
                self._next_ns += self._period_ns
                self._awaited = self._due(stop_ns)
            while self._waiting and self._waiting[0].t_ns == stop_ns:
                self._correct(filter_, self._waiting.pop(0), out)
            if self._open and not self._awaited:
                self._publish(filter_, out)

    def _due(self, t_ns: int) -> list[type[Signal]]:
        """What the sensors file has at ``t_ns``; satellites only until the descent begins, at 0."""
        s = self._suite
        periods: list[tuple[type[Signal], int]] = [
            (AdcpPing, s.adcp.period_ns),
            (PressureDepth, s.pressure.period_ns),
            (CompassHeading, s.compass.period_ns),
        ]
        if t_ns <= 0:
            periods += [(GnssFix, s.gnss.period_ns), (TdcpFix, s.tdcp.period_ns)]
        return [kind for kind, period_ns in periods if t_ns % period_ns == 0]

    def _correct(self, filter_: Filter, message: Aiding, out: list[Signal]) -> None:
        filter_.correct(message)
        if self._open:
            if type(message) in self._awaited:
                self._awaited.remove(type(message))
            if not self._awaited:
                self._publish(filter_, out)

    def _publish(self, filter_: Filter, out: list[Signal]) -> None:
        if self._open:
            self._open = False
            out.append(estimate(filter_, self._depth_m))
