"""Acoustic Doppler current profiler: four beams that look down, with cells along each.

Beams   e_1,2 = [+-sin a, 0, cos a] ahead and astern,  e_3,4 = [0, +-sin a, cos a] to starboard and to port, in the
        instrument's own axes;  M = M_err M_nominal turns them into the body's
Cells   slant range r_j = blanking + (j + 1/2) cell, as many as end within the range, at least one
Truth   d_i = R M e_i (NED),  z_ij = z + (R l)_down + r_j d_i,down,  v_t = v + R (w x l)
        b_ij = d_i . ([c(z_ij), 0] - v_t)        positive away from the vehicle; the water moves horizontally
Bottom  The side lobes of each beam also look straight down. Their echo off the sea bed, at the slant range of the
        transducer's altitude h, drowns that of the water. Cells with r_j > h give nothing (NaN), nor does a transducer
        below the bed (h <= 0), which is flat
Errors  + b_i + n_i exp(-r_j / length)           of each beam, constant through the run
        + N(0, sd^2)                             white, each cell
        +- outlier                               on a share of the cells; a share of the beams gives nothing (NaN)

M_err is the remaining error of the mounting: the instrument is misaligned by m ~ N(0, mounting_sd^2) about each body
axis, is calibrated to m + k with k ~ N(0, known_to^2), and is corrected by that, M_err = exp(m) exp(-(m + k)).
The mean current of a cell is taken at its centre. With cells of 1 m in a column of 1 m steps and 8 m of correlation
length the two differ by at most 9 % of the current's sd, 1.2 mm/s along a beam, where the white noise is 10 to 19.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc import so3
from ltv_mpc.frames import rotation, rotation_exp
from ltv_mpc.jit import jit
from ltv_mpc.localisation.sensors.adcp import Adcp, beam_directions
from ltv_mpc.messages import AdcpPing, Array, Triple
from sim.random_streams import Stream, generator
from sim.sensors.simulated import outliers
from sim.sensors.vehicle_state import VehicleState
from sim.water.column import WaterColumn, WaterSample, velocity_at


class Instrument:
    """Properties that pings at the water and at the sea bed share: transducers, mounting, biases of one device."""

    def __init__(self, settings: Adcp, seed: int) -> None:
        """Draw mounting and biases, once, from a stream of their own."""
        self.settings = settings
        draws = generator(seed, Stream.ADCP_INSTRUMENT)
        misalignment = settings.mounting_sd_rad * draws.standard_normal(3)
        calibrated = misalignment + settings.mounting_known_to_rad * draws.standard_normal(3)
        self.misalignment: Array = rotation_exp(misalignment) @ rotation_exp(-calibrated)  # M_err
        self.mounting: Array = self.misalignment @ rotation(*settings.mounting_rad)  # M
        self.beam_bias_mps: Array = settings.beam_bias_sd_mps * draws.standard_normal(4)
        self.near_bias_mps: Array = settings.near_bias_sd_mps * draws.standard_normal(4)
        self.beams: Array = beam_directions(settings.beam_angle_rad) @ self.mounting.T  # (4, 3), body


class Transducer(NamedTuple):
    """Position, motion and beams of the transducer."""

    depth_m: float  # of the vehicle
    velocity_mps: Triple  # of the vehicle over ground, NED
    R: Array  # (3, 3), body to NED
    rate_radps: Array  # (3,), body
    lever_m: Array  # (3,), body
    beams: Array  # (4, 3), M e_i, body


class Profiler:
    """Current profiler. ``ranges_m`` (K,) are those of the cells' centres; ``bias_mps`` is (4, K)."""

    def __init__(self, instrument: Instrument, water: WaterColumn, seed: int, bottom_m: float | None = None) -> None:
        """Create a profiler that draws noise, losses and outliers of its pings from a stream of its own.

        ``bottom_m`` is the depth of the sea bed; None: out of reach.
        """
        settings = self._settings = instrument.settings
        self._water, self._bottom_m = water, math.inf if bottom_m is None else bottom_m
        self.ranges_m = settings.cell_ranges_m
        self._draws = generator(seed, Stream.ADCP_PINGS)
        self.mounting = instrument.mounting
        self.beam_bias_mps, self.near_bias_mps = instrument.beam_bias_mps, instrument.near_bias_mps
        fading = np.exp(-self.ranges_m / settings.near_bias_length_m)
        self.bias_mps = self.beam_bias_mps[:, None] + self.near_bias_mps[:, None] * fading
        self._beams, self._lever = instrument.beams, np.array(settings.lever_arm_m)

    def sample(self, now: VehicleState) -> list[AdcpPing]:
        """Return one ping."""
        settings, shape = self._settings, self.bias_mps.shape
        transducer = Transducer(
            now.position_m[2], now.velocity_mps, now.rotation, now.angular_rate_radps, self._lever, self._beams
        )
        velocity = beam_velocities(transducer, self.ranges_m, self._water.sample(now.t_ns))
        # Everything is drawn at every ping, so that no setting changes the random numbers of another.
        noise = self._draws.standard_normal(shape)
        silent = self._draws.random(4) < settings.missing_share
        uniform = self._draws.random(shape)
        velocity += self.bias_mps + settings.beam_noise_sd_mps * noise
        velocity += settings.outlier_mps * outliers(uniform, settings.outlier_share)
        velocity[silent] = np.nan
        velocity[:, self.ranges_m > self._bottom_m - now.point_m(settings.lever_arm_m)[2]] = np.nan
        return [AdcpPing(t_ns=now.t_ns, range_m=self.ranges_m, beam_velocity_mps=velocity)]


@jit
def beam_velocities(transducer: Transducer, ranges: Array, water: WaterSample) -> Array:
    """Return the error-free b_ij (m/s), (4, K), at slant ranges (K,) (m)."""
    rate, lever, R = transducer.rate_radps, transducer.lever_m, transducer.R
    in_body, swing, d = np.empty(3), np.empty(3), np.empty(3)
    so3.cross(rate, lever, in_body)
    so3.rotate(R, in_body, swing)  # R (w x l)
    v = transducer.velocity_mps
    north, east, down = v[0] + swing[0], v[1] + swing[1], v[2] + swing[2]
    depth = transducer.depth_m + R[2, 0] * lever[0] + R[2, 1] * lever[1] + R[2, 2] * lever[2]
    b = np.empty((len(transducer.beams), len(ranges)))
    for i in range(len(transducer.beams)):
        so3.rotate(R, transducer.beams[i], d)
        for j in range(len(ranges)):
            c = velocity_at(depth + ranges[j] * d[2], water)
            b[i, j] = d[0] * (c[0] - north) + d[1] * (c[1] - east) - d[2] * down
    return b
