"""Bottom track: the velocity of the sea bed relative to the transducer, along each beam of the profiler.

Beams b_i (body) and u_i = R b_i (NED), mounting M, lever arm l and angular rate w as in ``adcp.py``:
    s   = -R^T v - w x l              velocity of the bed past the transducer, body
    z_i = b_i . s + n                 no beam bias: the echo of the bed is strong, and tracked, not averaged over a cell
Partials, with d = -v:
    d z / d v = -u_i,  d z / d phi = u_i x d,  d z / d mu = b_i x s,  d z / d b_g = l x b_i
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from msgspec import Meta

from ltv_mpc.localisation.filter.state import ATTITUDE, GYRO_BIAS, VELOCITY, Belief
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.localisation.sensors.sensor import Context, Linearised, Rows, Sensor
from ltv_mpc.localisation.sensors.settings import Latency, PositiveSd, Sd, SensorSettings, Share
from ltv_mpc.messages import BottomTrack


class BottomTracking(SensorSettings, frozen=True, kw_only=True):
    """Pings of the profiler at the sea bed: beams, mounting and lever arm of the profiler, noise of their own."""

    range_m: Annotated[float, Meta(gt=0, le=2000)]  # of the bottom, along the vertical
    beam_noise_sd_mps: PositiveSd
    missing_share: Share
    outlier_share: Share
    outlier_mps: Sd
    latency_ns: Latency = 0


def linearise(belief: Belief, ping: BottomTrack, tracking: BottomTracking, context: Context) -> Linearised:
    """Linearise a ping about the belief.

    Parameters
    ----------
    belief : the filter's belief at the ping's time.
    ping : velocity of the bed along each beam (m/s, positive away from the vehicle); NaN: no return.
    tracking : settings of the bottom track.
    context : settings of the profiler, and the measured angular rate.

    Returns
    -------
    One row a beam that has found the bottom; the index of a row is its beam.
    """
    adcp = context.sensor_config.adcp
    found = np.flatnonzero(~np.isnan(ping.beam_velocity_mps))
    b = beam_directions(adcp.beam_angle_rad)[found] @ belief.mounting.T
    u = b @ belief.R.T
    l = np.array(adcp.lever_arm_m)  # noqa: E741  (the lever arm's symbol)
    d = -belief.x[VELOCITY]
    s = belief.R.T @ d - np.cross(np.array(context.rate) - belief.x[GYRO_BIAS], l)
    at = np.r_[VELOCITY, ATTITUDE, GYRO_BIAS, belief.layout.mounting]
    partial = np.empty((len(found), len(at)))
    partial[:, :3] = -u
    partial[:, 3:6] = np.cross(u, d)
    partial[:, 6:9] = np.cross(l, b)
    if len(at) > 9:
        partial[:, 9:] = np.cross(b, s)
    rows = Rows(
        state=np.tile(at, (len(found), 1)),
        partial=partial,
        residual=ping.beam_velocity_mps[found] - b @ s,
        variance=np.full(len(found), tracking.beam_noise_sd_mps**2),
    )
    return Linearised(rows=rows, indices=found, unused={"no_return": 4 - len(found)})


BOTTOM_TRACK = Sensor(
    name="bottom_track",
    message=BottomTrack,
    settings=BottomTracking,
    scalars_per_message=4,
    at_rest=lambda t_ns, _: BottomTrack(t_ns=t_ns, range_m=np.ones(4), beam_velocity_mps=np.zeros(4)),
    linearise=linearise,
    is_essential=True,
)
