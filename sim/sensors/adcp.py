"""Acoustic Doppler current profiler: four beams down, cells along each.

Beams   e_1,2 = [+-sin a, 0, cos a] ahead and astern,  e_3,4 = [0, +-sin a, cos a] to starboard and to port, in the
        instrument's own axes;  M = M_err M_nominal turns them into the body's
Cells   slant range r_j = blanking + (j + 1/2) cell, as many as end within the range
Truth   d_i = R M e_i (NED),  z_ij = z + (R l)_down + r_j d_i,down,  v_t = v + R (w x l)
        b_ij = d_i . ([c(z_ij), 0] - v_t)        positive away from the vehicle; the water moves horizontally
Bottom  Each beam's side lobes also look straight down: their echo off the sea bed, at the slant range of the
        transducer's altitude h, drowns the water's. Cells with r_j > h give nothing (NaN), nor does a transducer below
        the bed (h <= 0), which is flat
Errors  + b_i + n_i exp(-r_j / length)           of each beam, constant through the run
        + N(0, sd^2)                             white, each cell
        +- outlier                               on a share of the cells; a share of the beams gives nothing (NaN)

M_err is what is left of the mounting: the instrument sits askew by m ~ N(0, mounting_sd^2) about each body axis, is
calibrated to m + k with k ~ N(0, known_to^2), and is turned back by that, M_err = exp(m) exp(-(m + k)).
A cell's mean of the current is taken at its centre: with cells of 1 m in a column of 1 m steps and 8 m of correlation
length the two differ by at most 9 % of the current's sd, 1.2 mm/s along a beam where the white noise is 10 to 19.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.frames import rotation, rotation_exp
from ltv_mpc.jit import jit
from ltv_mpc.localisation.sensors.adcp import Adcp
from ltv_mpc.messages import AdcpPing, Array, Triple
from sim.random_streams import Stream, generator
from sim.sensors.outlier_masks import Mask, OutlierMasks
from sim.sensors.vehicle_state import VehicleState
from sim.water.column import WaterColumn, velocity_at


class Instrument:
    """What its pings at the water and at the sea bed have in common: transducers, mounting, biases of one device."""

    def __init__(self, settings: Adcp, seed: int) -> None:
        """Mounting and biases are drawn once, from a stream of their own."""
        self.settings = settings
        draws = generator(seed, Stream.ADCP_INSTRUMENT)
        askew = settings.mounting_sd_rad * draws.standard_normal(3)
        calibrated = askew + settings.mounting_known_to_rad * draws.standard_normal(3)
        self.misalignment: Array = rotation_exp(askew) @ rotation_exp(-calibrated)  # M_err
        self.mounting: Array = self.misalignment @ rotation(*settings.mounting_rad)  # M
        self.beam_bias_mps: Array = settings.beam_bias_sd_mps * draws.standard_normal(4)
        self.near_bias_mps: Array = settings.near_bias_sd_mps * draws.standard_normal(4)
        self.beams: Array = beams(settings.beam_angle_rad) @ self.mounting.T  # (4, 3), body


class Profiler:
    """``ranges_m`` (K,) of the cells' centres; ``bias_mps`` (4, K). What else is true of it is the instrument's."""

    def __init__(self, instrument: Instrument, water: WaterColumn, seed: int, bottom_m: float | None = None) -> None:
        """Noise, gaps and outliers are drawn at each ping; ``bottom_m`` is the sea bed's depth, None out of reach."""
        settings = self._settings = instrument.settings
        self._water, self._bottom_m = water, math.inf if bottom_m is None else bottom_m
        cells = math.floor((settings.range_m - settings.blanking_m) / settings.cell_m + 1e-9)
        self.ranges_m: Array = settings.blanking_m + (np.arange(cells, dtype=np.float64) + 0.5) * settings.cell_m
        self._draws = generator(seed, Stream.ADCP_PINGS)
        self.mounting = instrument.mounting
        self.beam_bias_mps, self.near_bias_mps = instrument.beam_bias_mps, instrument.near_bias_mps
        fading = np.exp(-self.ranges_m / settings.near_bias_length_m)
        self.bias_mps = self.beam_bias_mps[:, None] + self.near_bias_mps[:, None] * fading
        self.outliers: Mask = np.zeros((4, cells), dtype=bool)  # of the last ping
        self.outlier_masks = OutlierMasks()
        self._beams, self._lever = instrument.beams, np.array(settings.lever_arm_m)

    def sample(self, now: VehicleState) -> list[AdcpPing]:
        """One ping."""
        settings, shape = self._settings, self.bias_mps.shape
        earlier, later, share = self._water.between(now.t_ns)
        velocity = beam_velocities(
            now.position_m[2],
            now.velocity_mps,
            now.rotation,
            now.angular_rate_radps,
            self._lever,
            self._beams,
            self.ranges_m,
            self._water.depth_m,
            earlier,
            later,
            share,
        )
        # Everything is drawn at every ping, so that no setting moves another's numbers.
        noise = self._draws.standard_normal(shape)
        silent = self._draws.random(4) < settings.missing_share
        wild = self._draws.random(shape)
        velocity += self.bias_mps + settings.beam_noise_sd_mps * noise
        up, down = wild < 0.5 * settings.outlier_share, wild > 1.0 - 0.5 * settings.outlier_share
        self.outliers = up | down
        self.outlier_masks.put(now.t_ns, self.outliers)
        velocity += settings.outlier_mps * (up.astype(np.float64) - down.astype(np.float64))
        velocity[silent] = np.nan
        velocity[:, self.ranges_m > self._bottom_m - now.point_m(settings.lever_arm_m)[2]] = np.nan
        return [AdcpPing(t_ns=now.t_ns, range_m=self.ranges_m, beam_velocity_mps=velocity)]


def beams(angle_rad: float) -> Array:
    """Unit vectors ahead, astern, to starboard, to port, each ``angle_rad`` off the vertical, shape (4, 3)."""
    s, c = math.sin(angle_rad), math.cos(angle_rad)
    return np.array([[s, 0.0, c], [-s, 0.0, c], [0.0, s, c], [0.0, -s, c]])


@jit
def beam_velocities(
    depth: float,
    velocity: Triple,
    R: Array,
    rate: Array,
    lever: Array,
    body_beams: Array,
    ranges: Array,
    depths: Array,
    earlier: Array,
    later: Array,
    share: float,
) -> Array:
    """Error-free b_ij (m/s), shape (4, K); ``body_beams`` (4, 3) are M e_i."""
    swing = np.empty(3)  # w x l
    swing[0] = rate[1] * lever[2] - rate[2] * lever[1]
    swing[1] = rate[2] * lever[0] - rate[0] * lever[2]
    swing[2] = rate[0] * lever[1] - rate[1] * lever[0]
    swing = R @ swing
    north, east, down = velocity[0] + swing[0], velocity[1] + swing[1], velocity[2] + swing[2]
    transducer = depth + R[2, 0] * lever[0] + R[2, 1] * lever[1] + R[2, 2] * lever[2]
    b = np.empty((len(body_beams), len(ranges)))
    for i in range(len(body_beams)):
        d = R @ body_beams[i]
        for j in range(len(ranges)):
            c = velocity_at(transducer + ranges[j] * d[2], depths, earlier, later, share)
            b[i, j] = d[0] * (c[0] - north) + d[1] * (c[1] - east) - d[2] * down
    return b
