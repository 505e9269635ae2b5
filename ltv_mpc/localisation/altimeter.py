"""Altitude above the bottom from the slant ranges of the bottom track.

Beam i with the slant range r_i and the direction u_i (unit vector, NED) finds the bottom at the depth

    d_i = z_transducer + r_i u_i,down

The bottom's depth is the median of the beams that found it, so that one false echo of four does not move it. It is
level between two pings, and for at most ``MAX_AGE_NS`` after the last one.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.localisation.filter.state import Belief
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.messages import BottomTrack

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
