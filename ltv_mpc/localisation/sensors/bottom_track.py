"""Bottom track: the velocity of the sea bed relative to the transducer, along each beam of the profiler.

Beams b_i (body) and u_i = R b_i (NED), mounting M, lever arm l and angular rate w as in ``adcp.py``:
    s   = -R^T v - w x l              velocity of the bed past the transducer, body
    z_i = b_i . s + n                 no beam bias: the echo of the bed is strong, and tracked, not averaged over a cell
Partials, with d = -v:
    d z / d v = -u_i,  d z / d phi = u_i x d,  d z / d mu = b_i x s,  d z / d b_g = l x b_i
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.localisation.filter.state import ATTITUDE, GYRO_BIAS, VELOCITY, Belief
from ltv_mpc.localisation.sensor_config import Adcp, BottomTracking
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.messages import BottomTrack, Triple


class Linearised(NamedTuple):
    """Of one ping: its rows, and how many beams have not found the bottom."""

    rows: Rows
    places: npt.NDArray[np.int64]  # (m,), beam of each row
    without_return: int


def linearise(belief: Belief, ping: BottomTrack, tracking: BottomTracking, adcp: Adcp, rate: Triple) -> Linearised:
    """``rate`` is the angular rate that the unit measured at the ping, bias included (rad/s, body)."""
    found = np.flatnonzero(~np.isnan(ping.beam_velocity_mps))
    b = beam_directions(adcp.beam_angle_rad)[found] @ belief.mounting.T
    u = b @ belief.R.T
    l = np.array(adcp.lever_arm_m)  # noqa: E741  (the lever arm's symbol)
    d = -belief.x[VELOCITY]
    s = belief.R.T @ d - np.cross(np.array(rate) - belief.x[GYRO_BIAS], l)
    mounting = belief.layout.mounting
    at = [
        *range(VELOCITY.start, VELOCITY.stop),
        *range(ATTITUDE.start, ATTITUDE.stop),
        *range(GYRO_BIAS.start, GYRO_BIAS.stop),
        *range(mounting.start, mounting.stop),
    ]
    partial = np.empty((len(found), len(at)))
    partial[:, :3] = -u
    partial[:, 3:6] = np.cross(u, d)
    partial[:, 6:9] = np.cross(l, b)
    if len(at) > 9:
        partial[:, 9:] = np.cross(b, s)
    rows = Rows(
        state=np.tile(np.array(at), (len(found), 1)),
        partial=partial,
        residual=ping.beam_velocity_mps[found] - b @ s,
        variance=np.full(len(found), tracking.beam_noise_sd_mps**2),
    )
    return Linearised(rows, found, 4 - len(found))
