"""Doppler profiler: the water's velocity relative to the transducer, along each beam, in cells of slant range.

Beam i (ahead, astern, starboard, port), cell j at slant range r_j; e_i in the instrument's axes, M to body, R to NED:
    e_1,2 = [+-sin a, 0, cos a],  e_3,4 = [0, +-sin a, cos a],   b_i = M e_i,   u_i = R b_i
    s    = R^T (c(z_ij) - v) - w x l                velocity of the water past the transducer, body
    z_ij = b_i . s + beta_i + gamma_i exp(-r_j / r0) + n
    z_cell = p_d + [R (l + r_j b_i)]_d              every beam has depths of its own, as the vehicle need not be level
c(z) is linear between the two grid points around the cell; by g = u_i . dc/dz depth errors reach the velocity.
Partials, with d = c - v, q = R (l + r_j b_i), error conventions of ``state.py``:
    d z / d v    = -u_i                          d z / d p_d  = g
    d z / d phi  = u_i x d + g [q_e, -q_n, 0]    (R^T turns by -phi; [phi x q]_d = phi_n q_e - phi_e q_n)
    d z / d mu   = b_i x (s + g r_j R^T [0,0,1]) (b + mu x b)
    d z / d b_g  = l x b_i                       (w = w_m - b_g)
    d z / d c_k  = (1 - t) u_i,  d z / d c_k+1 = t u_i
Each row, one cell of one beam, is gated by itself in ``filter/update.py``; the gate follows from
``gate_probability`` of ``localisation/config.py``.
Source  Medagoda & Williams 2012, section II.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from msgspec import Meta

from ltv_mpc.frames import skew
from ltv_mpc.localisation.filter.state import ATTITUDE, GYRO_BIAS, VELOCITY, Belief
from ltv_mpc.localisation.sensors.sensor import Context, Indices, Linearised, Rows, Sensor
from ltv_mpc.localisation.sensors.settings import Angles, Latency, Lever, PositiveSd, Sd, SensorSettings, Share
from ltv_mpc.messages import AdcpPing, Array

_STATES = np.r_[2, VELOCITY, ATTITUDE, GYRO_BIAS]
"""States on which every row depends: depth, velocity, attitude, gyro bias."""


class Adcp(SensorSettings, frozen=True, kw_only=True):
    """Four-beam Janus current profiler that looks down; beams ahead, astern, to starboard, to port of its own axes."""

    beam_angle_rad: Annotated[float, Meta(gt=0, lt=1.2)]
    cell_m: Annotated[float, Meta(gt=0, le=100)]
    blanking_m: Annotated[float, Meta(ge=0, le=100)]
    range_m: Annotated[float, Meta(gt=0, le=2000)]
    beam_noise_sd_mps: PositiveSd
    beam_bias_sd_mps: Sd  # each beam, constant
    near_bias_sd_mps: Sd  # each beam, times exp(-range / near_bias_length_m)
    near_bias_length_m: Annotated[float, Meta(gt=0, le=100)]
    missing_share: Share
    outlier_share: Share
    outlier_mps: Sd
    mounting_sd_rad: Sd  # true misalignment, each axis
    mounting_known_to_rad: Sd  # error of its calibration, each axis
    lever_arm_m: Lever
    mounting_rad: Angles = (0.0, 0.0, 0.0)  # nominal roll, pitch, yaw of its axes in the body's
    latency_ns: Latency = 0

    @property
    def cell_ranges_m(self) -> Array:
        """Ranges of the middles of the cells along a beam (m), (K,): those that end within the range, at least one."""
        cells = max(math.floor((self.range_m - self.blanking_m) / self.cell_m + 1e-9), 1)
        return self.blanking_m + (np.arange(cells, dtype=np.float64) + 0.5) * self.cell_m


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearisedPing(Linearised):
    """Rows of a ping, and the grid points of the water that they lie between. The index is beam x cells + cell."""

    grid_points: Indices  # (m,), the shallower of each row's two

    @property
    def beams(self) -> Array:
        """Direction u of each row's beam, (m, 3), NED."""
        return -self.rows.partial[:, 1:4]


def beam_directions(beam_angle_rad: float) -> Array:
    """Return the unit vectors e of the beams, (4, 3), in the instrument's axes."""
    s, c = math.sin(beam_angle_rad), math.cos(beam_angle_rad)
    return np.array([[s, 0.0, c], [-s, 0.0, c], [0.0, s, c], [0.0, -s, c]])


def linearise(belief: Belief, ping: AdcpPing, adcp: Adcp, context: Context) -> LinearisedPing:
    """Linearise a ping about the belief.

    Parameters
    ----------
    belief : the filter's belief at the ping's time.
    ping : velocity of the water along each beam (4, K) (m/s, positive away from the vehicle); NaN: no return.
    adcp : settings of the profiler.
    context : spacing of the water's grid points, and the measured angular rate.

    Returns
    -------
    One row a beam cell that returned an echo and lies within the grid.
    """
    z, layout, x, R = ping.beam_velocity_mps, belief.layout, belief.x, belief.R
    l = np.array(adcp.lever_arm_m)  # noqa: E741  (the lever arm's symbol)
    beams = beam_directions(adcp.beam_angle_rad) @ belief.mounting.T
    transducer = R @ l
    swing = skew(context.rate - x[GYRO_BIAS]) @ l
    water = x[layout.north.start : layout.east.stop].reshape(2, -1)

    depth = (x[2] + transducer[2] + np.outer(beams @ R[2], ping.range_m)) / context.cell_m
    k = np.floor(depth).astype(np.int64)
    returned = ~np.isnan(z)
    inside = (k >= 0) & (k <= water.shape[1] - 2)
    i, j = np.nonzero(returned & inside)
    b, r, k = beams[i], ping.range_m[j, None], k[i, j]
    u, t = b @ R.T, depth[i, j, None] - k[:, None]
    upper, lower = water[:, k].T, water[:, k + 1].T
    d = -np.tile(x[VELOCITY], (len(i), 1))  # c - v
    d[:, :2] += upper + t * (lower - upper)
    g = (u[:, :2] * (lower - upper)).sum(axis=1, keepdims=True) / context.cell_m
    by_attitude, q = _cross(u, d), transducer + r * u
    by_attitude[:, :2] += g * np.stack([q[:, 1], -q[:, 0]], axis=1)
    nodes, weights = np.stack([k, k + 1], axis=1), np.hstack([1.0 - t, t])
    fading = np.exp(-r / adcp.near_bias_length_m)
    groups: list[tuple[Indices, Array]] = [
        (_STATES, np.hstack([g, -u, by_attitude, -b @ skew(l)])),
        (layout.north.start + nodes, u[:, :1] * weights),
        (layout.east.start + nodes, u[:, 1:2] * weights),
    ]
    residual = z[i, j] - (u * d).sum(axis=1) + b @ swing
    for states, partial in ((layout.beam_bias, np.ones_like(r)), (layout.near_bias, fading)):
        if states.stop > states.start:
            groups.append((states.start + i[:, None], partial))
            residual -= x[states][i] * partial[:, 0]
    if layout.mounting.stop > layout.mounting.start:
        down = np.array([0.0, 0.0, 1.0])
        groups.append((np.r_[layout.mounting], _cross(b, (d + g * r * down) @ R - swing)))
    return LinearisedPing(
        rows=Rows(
            state=np.hstack([np.broadcast_to(states, partial.shape) for states, partial in groups]),
            partial=np.hstack([partial for _, partial in groups]),
            residual=residual,
            variance=np.full(len(i), adcp.beam_noise_sd_mps**2),
        ),
        indices=i * z.shape[1] + j,
        unused={"no_return": int((~returned).sum()), "outside_grid": int((returned & ~inside).sum())},
        grid_points=k,
    )


def _cross(a: Array, b: Array) -> Array:
    """Return a x b of each row, (m, 3). ``np.cross`` takes twice as long."""
    return a[:, (1, 2, 0)] * b[:, (2, 0, 1)] - a[:, (2, 0, 1)] * b[:, (1, 2, 0)]


def _at_rest(t_ns: int, adcp: Adcp) -> AdcpPing:
    range_m = adcp.cell_ranges_m
    return AdcpPing(t_ns=t_ns, range_m=range_m, beam_velocity_mps=np.full((4, len(range_m)), 1e-15 * t_ns))


def _reading(ping: AdcpPing) -> bytes | None:
    return None if np.isnan(ping.beam_velocity_mps).all() else ping.beam_velocity_mps.tobytes()


ADCP = Sensor(
    name="adcp",
    message=AdcpPing,
    settings=Adcp,
    scalars_per_message=4,
    at_rest=_at_rest,
    linearise=linearise,
    is_essential=True,
    reading=_reading,
)
