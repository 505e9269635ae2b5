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

import numpy as np

from ltv_mpc.frames import rotation, rotation_exp
from ltv_mpc.localisation.sensors.adcp import Adcp, beam_directions
from ltv_mpc.messages import AdcpPing, Array, Triple
from sim.random_streams import Stream, generator
from sim.sensors.simulated import outliers
from sim.sensors.vehicle_state import VehicleState
from sim.water.column import WaterColumn, WaterSample, velocities_at_depths


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
        self._beams = instrument.beams

    def sample(self, now: VehicleState) -> list[AdcpPing]:
        """Return one ping."""
        settings, shape = self._settings, self.bias_mps.shape
        lever, water = settings.lever_arm_m, self._water.sample(now.t_ns)
        velocity = beam_velocities(now, lever, self._beams, self.ranges_m, water)
        # Everything is drawn at every ping, so that no setting changes the random numbers of another.
        noise = self._draws.standard_normal(shape)
        silent = self._draws.random(4) < settings.missing_share
        uniform = self._draws.random(shape)
        velocity += self.bias_mps + settings.beam_noise_sd_mps * noise
        velocity += settings.outlier_mps * outliers(uniform, settings.outlier_share)
        velocity[silent] = np.nan
        velocity[:, self.ranges_m > self._bottom_m - now.point_m(lever)[2]] = np.nan
        return [AdcpPing(t_ns=now.t_ns, range_m=self.ranges_m, beam_velocity_mps=velocity)]


def beam_velocities(now: VehicleState, lever_m: Triple, beams: Array, ranges_m: Array, water: WaterSample) -> Array:
    """Return the error-free b_ij (m/s), (4, K), of beams M e_i (4, 3) in body axes at slant ranges (K,)."""
    d = beams @ now.rotation.T
    depths = now.point_m(lever_m)[2] + np.outer(d[:, 2], ranges_m)
    c = velocities_at_depths(depths.ravel(), water).reshape(*depths.shape, 2)
    velocities: Array = (d[:, None, :2] * c).sum(axis=2) - (d @ now.point_velocity_mps(lever_m))[:, None]
    return velocities
