"""Publishing: when estimates and checkpoints are published, and how an estimate is computed from a filter.

Rate        w = w_m - b_g - R^T W                              against NED, body axes; W: the Earth's
            heading' = (w_y sin roll + w_z cos roll) / cos pitch
Covariance  J P J^T of [n, e, v_n, v_e, heading, heading'], J by the fifteen core states. The white noise of the gyros
            is new in each sample, so it is added to the variance of heading'.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ltv_mpc.frames import roll_pitch_heading
from ltv_mpc.localisation import current_model
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import ATTITUDE, CORE, GYRO_BIAS, Belief
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import fitted
from ltv_mpc.localisation.sensors.compass import heading_partials
from ltv_mpc.localisation.sensors.sensor import Availability
from ltv_mpc.localisation.sensors.settings import latency_ns
from ltv_mpc.messages import Array, Estimate

_REPORTED = (0, 1, 3, 4)
"""Indices of position and velocity, north and east."""

CHECKPOINT_NS = 5_000_000_000
SUBMERGED_M, SURFACED_M = 1.0, 0.5
"""Depths between which the vehicle keeps its side of the surface: submerged below the first, surfaced above the
second."""


class EstimateSchedule:
    """Instants of the estimates: one at every multiple of the period, open until all that is due then has arrived.

    The estimate of an instant holds all measurements up to and at that instant that have arrived. It is complete when
    every sensor without latency that is due at the instant has been received.
    """

    def __init__(self, sensor_config: SensorConfig, period_ns: int) -> None:
        """Create a schedule without a start time.

        Parameters
        ----------
        sensor_config : settings of the sensors: period and latency of each.
        period_ns : between two estimates (ns).
        """
        self.next_ns = 0
        self.is_open = False
        self._expected = tuple(_expected(sensor_config))
        self._period_ns = period_ns
        self._awaited: list[type[Any]] = []

    @property
    def is_complete(self) -> bool:
        """True if an estimate is open and no message is awaited for it."""
        return self.is_open and not self._awaited

    def begin(self, t_ns: int) -> None:
        """Set the next estimate to the first multiple of the period after ``t_ns``.

        Parameters
        ----------
        t_ns : time of the first belief (ns).
        """
        self.next_ns = (t_ns // self._period_ns + 1) * self._period_ns

    def reach(self, t_ns: int) -> None:
        """Open the estimate of ``t_ns`` if one is due then.

        Parameters
        ----------
        t_ns : the filter's time (ns).
        """
        if t_ns == self.next_ns:
            self.is_open = True
            self.next_ns += self._period_ns
            self._awaited = self._due(t_ns)

    def receive(self, kind: type[Any]) -> None:
        """Note that a message of the open estimate's instant has arrived.

        Parameters
        ----------
        kind : type of the message.
        """
        if self.is_open and kind in self._awaited:
            self._awaited.remove(kind)

    def _due(self, t_ns: int) -> list[type[Any]]:
        """Return the types of the messages that are valid at ``t_ns`` and arrive without latency."""
        return [message for message, period_ns, until_ns in self._expected if t_ns <= until_ns and not t_ns % period_ns]


def _expected(sensor_config: SensorConfig) -> Iterator[tuple[type[Any], int, float]]:
    """Iterate over the messages that an estimate waits for: type, period (ns) and time of the last one (ns)."""
    for sensor, settings in fitted(sensor_config):
        if sensor.availability is not Availability.INTERMITTENT and latency_ns(settings) == 0:
            until_ns = 0.0 if sensor.availability is Availability.SURFACE else math.inf
            yield sensor.message, settings.period_ns, until_ns


class CheckpointSchedule:
    """Instants of the checkpoints: every ``CHECKPOINT_NS``, and when the vehicle submerges or surfaces."""

    def __init__(self) -> None:
        self._next_ns = 0
        self._submerged = False

    def begin(self, belief: Belief) -> None:
        """Make a checkpoint due at the first estimate.

        Parameters
        ----------
        belief : the first belief.
        """
        self._next_ns = belief.t_ns
        self._submerged = float(belief.x[2]) > SUBMERGED_M

    def is_due(self, belief: Belief) -> bool:
        """Return True if a checkpoint is due, by time or by depth.

        Parameters
        ----------
        belief : the filter's belief at the estimate's instant.
        """
        return self._crossed(belief) or belief.t_ns >= self._next_ns

    def advance(self, belief: Belief) -> None:
        """Schedule the next checkpoint after one of ``belief`` has been published.

        Parameters
        ----------
        belief : that of the published checkpoint.
        """
        self._submerged ^= self._crossed(belief)
        self._next_ns = (belief.t_ns // CHECKPOINT_NS + 1) * CHECKPOINT_NS

    def _crossed(self, belief: Belief) -> bool:
        """Return True if the vehicle has surfaced or submerged since the last checkpoint."""
        depth_m = float(belief.x[2])
        return depth_m < SURFACED_M if self._submerged else depth_m > SUBMERGED_M


def estimate(filter_: ErrorStateFilter, depth_m: Array, altitude_m: float | None = None) -> Estimate:
    """Return the estimate of a filter at the time of its belief.

    Parameters
    ----------
    filter_ : the active filter; it is not changed.
    depth_m : (G,) grid of the water (m).
    altitude_m : height above the bottom (m); None if it is not seen.
    """
    belief = filter_.belief
    roll, pitch, heading = roll_pitch_heading(belief.R)
    w = filter_.angular_rate_radps - belief.x[GYRO_BIAS] - filter_.earth_rate_radps @ belief.R
    turn = np.array([0.0, math.sin(roll), math.cos(roll)]) / math.cos(pitch)  # heading' = turn . w
    J = np.zeros((6, CORE))
    J[range(4), _REPORTED] = 1.0
    J[4, ATTITUDE], J[5, GYRO_BIAS] = heading_partials(belief.R), -turn
    covariance = J @ filter_.core_covariance() @ J.T
    covariance[5, 5] += filter_.angular_rate_variance * (turn @ turn)
    north, east, down, v_north, v_east, v_down = belief.x[:6].tolist()
    return Estimate(
        t_ns=belief.t_ns,
        north_m=north,
        east_m=east,
        heading_rad=heading,
        yaw_rate_radps=float(turn @ w),
        velocity_north_mps=v_north,
        velocity_east_mps=v_east,
        depth_m=down,
        velocity_down_mps=v_down,
        altitude_m=altitude_m,
        covariance=0.5 * (covariance + covariance.T),
        current=current_model.profile(belief, depth_m),
    )
