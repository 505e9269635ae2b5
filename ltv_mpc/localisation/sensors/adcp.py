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
Each row, one cell of one beam, is gated by itself in ``filter/correction.py``; the gate follows from
``gate_probability`` of ``localisation/config.py``.
Source  Medagoda & Williams 2012, section II.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from ltv_mpc import so3
from ltv_mpc.frames import skew
from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.state import GYRO_BIAS, Belief, Layout
from ltv_mpc.localisation.sensors.rows import Indices, Linearised, Rows
from ltv_mpc.localisation.sensors.sensor import Context, Sensor
from ltv_mpc.localisation.sensors.settings import Angles, Latency, Lever, PositiveSd, Sd, SensorSettings, Share
from ltv_mpc.messages import AdcpPing, Array

_WIDTH = 19
"""States of a row: depth 1, velocity 3, attitude 3, gyro bias 3, water 4, the beam's two biases 2, mounting 3."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearisedPing(Linearised):
    """Rows of a ping, and the grid points of the water that they lie between. The index is beam x cells + cell."""

    grid_points: Indices  # (m,), in the whole grid, the shallower of each row's two

    @property
    def beams(self) -> Array:
        """Direction u of each row's beam, (m, 3), NED."""
        return -self.rows.partial[:, 1:4]


class _States(NamedTuple):
    """First index of each group of states; -1: the group does not exist."""

    beam_bias: int
    near_bias: int
    mounting: int
    north: int
    east: int


class _Grid(NamedTuple):
    """Grid points of the water that are states."""

    cell_m: float  # spacing
    first: int  # in the whole grid
    size: int  # number of grid points


class _Geometry(NamedTuple):
    """Position and motion of the transducer."""

    R: Array  # (3, 3), body to NED
    beams: Array  # (4, 3), b in body axes
    rate: Array  # (3,), w (rad/s, body)
    lever: Array  # (3,), l (m, body)
    near_length: float  # r0 (m)


class _Buffers(NamedTuple):
    """Rows to be filled, (M, _WIDTH) or (M,)."""

    state: Indices
    partial: Array
    residual: Array
    cell: Indices
    shallower: Indices  # the shallower of the two grid points that the cell lies between


def beam_directions(beam_angle_rad: float) -> Array:
    """Return the unit vectors e of the beams, (4, 3), in the instrument's axes."""
    s, c = math.sin(beam_angle_rad), math.cos(beam_angle_rad)
    return np.array([[s, 0.0, c], [-s, 0.0, c], [0.0, s, c], [0.0, -s, c]])


@jit
def _fill(
    z: Array, ranges: Array, x: Array, geometry: _Geometry, states: _States, grid: _Grid, out: _Buffers
) -> tuple[int, int, int]:
    """Fill a row for every usable beam cell.

    Return the number of rows, of cells without a return (NaN), and of cells outside the grid.
    """
    R, l = geometry.R, geometry.lever  # noqa: E741  (the lever arm's symbol)
    u, transducer, relative, by_gyro_bias, d = np.empty((4, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    so3.rotate(R, l, transducer)
    so3.cross(geometry.rate, l, relative)  # w x l
    m = without_return = outside = 0
    for i in range(4):
        b = geometry.beams[i]
        so3.rotate(R, b, u[i])  # the beam in NED
        so3.cross(l, b, by_gyro_bias)
        by_attitude, by_mounting = skew(u[i]), skew(b)
        swept = b[0] * relative[0] + b[1] * relative[1] + b[2] * relative[2]
        for j in range(ranges.shape[0]):
            if math.isnan(z[i, j]):
                without_return += 1
                continue
            depth = (x[2] + transducer[2] + ranges[j] * u[i, 2]) / grid.cell_m
            k = math.floor(depth) - grid.first
            if k < 0 or k > grid.size - 2:
                outside += 1
                continue
            t = depth - (grid.first + k)
            n, e = states.north + k, states.east + k
            d[0] = (1.0 - t) * x[n] + t * x[n + 1] - x[3]
            d[1] = (1.0 - t) * x[e] + t * x[e + 1] - x[4]
            d[2] = -x[5]
            g = (u[i, 0] * (x[n + 1] - x[n]) + u[i, 1] * (x[e + 1] - x[e])) / grid.cell_m
            # b . (R^T d - w x l)
            expected = u[i, 0] * d[0] + u[i, 1] * d[1] + u[i, 2] * d[2] - swept

            state, partial = out.state[m], out.partial[m]
            state[0], partial[0] = 2, g
            for a in range(3):
                state[1 + a], partial[1 + a] = 3 + a, -u[i, a]
                state[4 + a] = 6 + a
                partial[4 + a] = by_attitude[a, 0] * d[0] + by_attitude[a, 1] * d[1] + by_attitude[a, 2] * d[2]
                state[7 + a], partial[7 + a] = 9 + a, by_gyro_bias[a]
            partial[4] += g * (transducer[1] + ranges[j] * u[i, 1])
            partial[5] -= g * (transducer[0] + ranges[j] * u[i, 0])
            state[10], partial[10] = n, (1.0 - t) * u[i, 0]
            state[11], partial[11] = n + 1, t * u[i, 0]
            state[12], partial[12] = e, (1.0 - t) * u[i, 1]
            state[13], partial[13] = e + 1, t * u[i, 1]
            fading = math.exp(-ranges[j] / geometry.near_length)
            expected = _with_biases(expected, x, i, fading, states, state, partial)
            _fill_mounting(R, d, g * ranges[j], relative, by_mounting, states.mounting, state, partial)
            out.residual[m] = z[i, j] - expected
            out.cell[m] = i * ranges.shape[0] + j
            out.shallower[m] = grid.first + k
            m += 1
    return m, without_return, outside


@jit
def _with_biases(
    expected: float, x: Array, i: int, fading: float, states: _States, state: Indices, partial: Array
) -> float:
    """Fill the biases of beam i; return the expected measurement with them."""
    state[14], partial[14] = 0, 0.0
    state[15], partial[15] = 0, 0.0
    if states.beam_bias >= 0:
        state[14], partial[14] = states.beam_bias + i, 1.0
        expected += x[states.beam_bias + i]
    if states.near_bias >= 0:
        state[15], partial[15] = states.near_bias + i, fading
        expected += x[states.near_bias + i] * fading
    return expected


@jit
def _fill_mounting(
    R: Array, d: Array, shear: float, relative: Array, b_cross: Array, first: int, state: Indices, partial: Array
) -> None:
    """Fill b x (s + g r R^T [0, 0, 1]), with ``shear`` = g r, ``relative`` = w x l and ``b_cross`` = b^."""
    s = np.empty(3)
    for a in range(3):
        s[a] = R[0, a] * d[0] + R[1, a] * d[1] + R[2, a] * (d[2] + shear) - relative[a]
    for a in range(3):
        state[16 + a], partial[16 + a] = 0, 0.0
        if first >= 0:
            state[16 + a] = first + a
            partial[16 + a] = b_cross[a, 0] * s[0] + b_cross[a, 1] * s[1] + b_cross[a, 2] * s[2]


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
    z = np.ascontiguousarray(ping.beam_velocity_mps)
    out = _Buffers(
        state=np.empty((z.size, _WIDTH), dtype=np.int64),
        partial=np.empty((z.size, _WIDTH)),
        residual=np.empty(z.size),
        cell=np.empty(z.size, dtype=np.int64),
        shallower=np.empty(z.size, dtype=np.int64),
    )
    geometry = _Geometry(
        R=belief.R,
        beams=beam_directions(adcp.beam_angle_rad) @ belief.mounting.T,
        rate=np.array(context.rate) - belief.x[GYRO_BIAS],
        lever=np.array(adcp.lever_arm_m),
        near_length=adcp.near_bias_length_m,
    )
    layout = belief.layout
    grid = _Grid(context.cell_m, belief.column.first, layout.north.stop - layout.north.start)
    ranges = np.ascontiguousarray(ping.range_m)
    m, without_return, outside = _fill(z, ranges, belief.x, geometry, _states(layout), grid, out)
    variance = np.full(m, adcp.beam_noise_sd_mps**2)
    return LinearisedPing(
        rows=Rows(out.state[:m], out.partial[:m], out.residual[:m], variance),
        indices=out.cell[:m],
        unused={"no_return": without_return, "outside_grid": outside},
        grid_points=out.shallower[:m],
    )


def _states(layout: Layout) -> _States:
    beam_bias, near_bias, mounting = (
        part.start if part.stop > part.start else -1 for part in (layout.beam_bias, layout.near_bias, layout.mounting)
    )
    return _States(beam_bias, near_bias, mounting, layout.north.start, layout.east.start)


def _at_rest(t_ns: int, adcp: Adcp) -> AdcpPing:
    cells = max(1.0, (adcp.range_m - adcp.blanking_m) // adcp.cell_m)
    range_m = adcp.blanking_m + adcp.cell_m * np.arange(0.5, cells)
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
