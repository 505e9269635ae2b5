"""Doppler profiler: the water's velocity relative to the transducer, along each beam, in cells of slant range.

Beam i (ahead, astern, starboard, port), cell j at slant range r_j; e_i in the instrument's axes, M to body, R to NED:
    e_1,2 = [+-sin a, 0, cos a],  e_3,4 = [0, +-sin a, cos a],   b_i = M e_i,   u_i = R b_i
    s    = R^T (c(z_ij) - v) - w x l                velocity of the water past the transducer, body
    z_ij = b_i . s + beta_i + gamma_i exp(-r_j / r0) + n
    z_cell = p_d + [R (l + r_j b_i)]_d              the vehicle need not be level: every beam has depths of its own
c(z) is linear between the two nodes that the cell straddles; g = u_i . dc/dz is how depth errors reach the velocity.
Partials, with d = c - v, q = R (l + r_j b_i), error conventions of ``state.py``:
    d z / d v    = -u_i                          d z / d p_d  = g
    d z / d phi  = u_i x d + g [q_e, -q_n, 0]    (R^T turns by -phi; [phi x q]_d = phi_n q_e - phi_e q_n)
    d z / d mu   = b_i x (s + g r_j R^T [0,0,1]) (b + mu x b)
    d z / d b_g  = l x b_i                       (w = w_m - b_g)
    d z / d c_k  = (1 - t) u_i,  d z / d c_k+1 = t u_i
Source  Medagoda & Williams 2012, section II; ../shared/design/localisation.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from ltv_mpc.frames import skew
from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensor_config import Adcp
from ltv_mpc.localisation.sensors.rows import Rows
from ltv_mpc.messages import AdcpPing, Array, Triple

Indices: TypeAlias = npt.NDArray[np.int64]

_WIDTH = 19
"""Of a row: depth 1, velocity 3, attitude 3, gyro bias 3, beam's two biases 2, mounting 3, water 4."""


class Linearised(NamedTuple):
    """Of one ping: its rows, what could not be used, and why."""

    rows: Rows
    places: Indices  # (m,), beam x cells + cell of each row
    without_return: int  # beam cells that hold NaN
    nodes: Indices  # (m,), upper one of the two that each row's cell lies between, of the whole grid
    outside_grid: int  # beam cells above the first or below the last node of the window

    @property
    def beams(self) -> Array:
        """u of each row, (m, 3), NED."""
        return -self.rows.partial[:, 1:4]


def beam_directions(beam_angle_rad: float) -> Array:
    """e_i, (4, 3), in the instrument's axes."""
    s, c = math.sin(beam_angle_rad), math.cos(beam_angle_rad)
    return np.array([[s, 0.0, c], [-s, 0.0, c], [0.0, s, c], [0.0, -s, c]])


@jit
def _fill(
    z: Array,
    ranges: Array,
    x: Array,
    R: Array,
    b: Array,
    w: Array,
    l: Array,  # noqa: E741  (the lever arm's symbol)
    near_length: float,
    cell_m: float,
    starts: Indices,
    state: Indices,
    partial: Array,
    residual: Array,
    places: Indices,
    upper: Indices,
    first: int,
) -> tuple[int, int, int]:
    """Rows for every usable beam cell; returns how many, and how many had no return or lay outside the grid.

    ``starts`` are the first indices of beam bias, near bias, mounting, north, east (-1: absent) and the node count.
    ``first`` is the grid's node that the first of each stands for.
    """
    at_beam, at_near, at_mounting, at_north, at_east, nodes = starts
    u = b @ R.T  # beams in NED, (4, 3)
    transducer = R @ l
    relative = skew(w) @ l  # w x l
    d = np.empty(3)
    s = np.empty(3)
    m = without_return = outside = 0
    for i in range(4):
        turning, tilting = skew(u[i]), skew(b[i])
        gyro = skew(l) @ b[i]
        swept = b[i, 0] * relative[0] + b[i, 1] * relative[1] + b[i, 2] * relative[2]
        for j in range(ranges.shape[0]):
            if math.isnan(z[i, j]):
                without_return += 1
                continue
            depth = (x[2] + transducer[2] + ranges[j] * u[i, 2]) / cell_m
            k = math.floor(depth) - first
            if k < 0 or k > nodes - 2:
                outside += 1
                continue
            t = depth - (first + k)
            n, e = at_north + k, at_east + k
            d[0] = (1.0 - t) * x[n] + t * x[n + 1] - x[3]
            d[1] = (1.0 - t) * x[e] + t * x[e + 1] - x[4]
            d[2] = -x[5]
            g = (u[i, 0] * (x[n + 1] - x[n]) + u[i, 1] * (x[e + 1] - x[e])) / cell_m
            # b . (R^T d - w x l)
            expected = u[i, 0] * d[0] + u[i, 1] * d[1] + u[i, 2] * d[2] - swept

            state[m, 0], partial[m, 0] = 2, g
            for a in range(3):
                state[m, 1 + a], partial[m, 1 + a] = 3 + a, -u[i, a]
                state[m, 4 + a] = 6 + a
                partial[m, 4 + a] = turning[a, 0] * d[0] + turning[a, 1] * d[1] + turning[a, 2] * d[2]
                state[m, 7 + a], partial[m, 7 + a] = 9 + a, gyro[a]
            partial[m, 4] += g * (transducer[1] + ranges[j] * u[i, 1])
            partial[m, 5] -= g * (transducer[0] + ranges[j] * u[i, 0])
            state[m, 10], partial[m, 10] = n, (1.0 - t) * u[i, 0]
            state[m, 11], partial[m, 11] = n + 1, t * u[i, 0]
            state[m, 12], partial[m, 12] = e, (1.0 - t) * u[i, 1]
            state[m, 13], partial[m, 13] = e + 1, t * u[i, 1]
            for a in range(14, 19):
                state[m, a], partial[m, a] = 0, 0.0
            if at_beam >= 0:
                state[m, 14], partial[m, 14] = at_beam + i, 1.0
                expected += x[at_beam + i]
            if at_near >= 0:
                fading = math.exp(-ranges[j] / near_length)
                state[m, 15], partial[m, 15] = at_near + i, fading
                expected += x[at_near + i] * fading
            if at_mounting >= 0:
                for a in range(3):
                    s[a] = R[0, a] * d[0] + R[1, a] * d[1] + R[2, a] * (d[2] + g * ranges[j]) - relative[a]
                for a in range(3):
                    state[m, 16 + a] = at_mounting + a
                    partial[m, 16 + a] = tilting[a, 0] * s[0] + tilting[a, 1] * s[1] + tilting[a, 2] * s[2]
            residual[m] = z[i, j] - expected
            places[m] = i * ranges.shape[0] + j
            upper[m] = first + k
            m += 1
    return m, without_return, outside


class AdcpModel:
    """The profiler as mounted: linearises a ping about a belief."""

    def __init__(self, adcp: Adcp, layout: Layout, cell_m: float) -> None:
        """``cell_m`` is the spacing of the water's nodes."""
        self._adcp = adcp
        self._beams = beam_directions(adcp.beam_angle_rad)
        self._lever = np.array(adcp.lever_arm_m)
        self._cell_m = cell_m
        optional = (layout.beam_bias, layout.near_bias, layout.mounting)
        self._starts = np.array(
            [
                *(s.start if s.stop > s.start else -1 for s in optional),
                layout.north.start,
                layout.east.start,
                layout.north.stop - layout.north.start,
            ]
        )

    def linearise(self, belief: Belief, ping: AdcpPing, rate: Triple) -> Linearised:
        """``rate`` is the angular rate that the unit measured at the ping, bias included (rad/s, body)."""
        z = np.ascontiguousarray(ping.beam_velocity_mps)
        state = np.empty((z.size, _WIDTH), dtype=np.int64)
        partial = np.empty((z.size, _WIDTH))
        residual = np.empty(z.size)
        places, upper = np.empty(z.size, dtype=np.int64), np.empty(z.size, dtype=np.int64)
        m, without_return, outside = _fill(
            z,
            np.ascontiguousarray(ping.range_m),
            belief.x,
            belief.R,
            self._beams @ belief.mounting.T,
            np.array(rate) - belief.x[9:12],
            self._lever,
            self._adcp.near_bias_length_m,
            self._cell_m,
            self._starts,
            state,
            partial,
            residual,
            places,
            upper,
            belief.column.first,
        )
        variance = np.full(m, self._adcp.beam_noise_sd_mps**2)
        rows = Rows(state[:m], partial[:m], residual[:m], variance)
        return Linearised(rows, places[:m], without_return, upper[:m], outside)
