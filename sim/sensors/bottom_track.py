"""Bottom track: pings of the profiler at the sea bed, which is flat and does not move.

Beams   u_i = R M e_i (NED): those of the profiler, with its mounting and its lever arm l
Truth   v_t = v + R (w x l),  h = bottom - (z + (R l)_down)
        b_i = u_i . (0 - v_t)         velocity of the bed past the transducer, positive away from the vehicle
        r_i = h / u_i,down            without error, since the filter uses the velocities alone
Lost    all beams if the bed is further than ``range_m`` below the transducer, or above it; a beam that meets the bed
        at more than 70 deg off the vertical, which hardly scatters back (Lambert's law); a share of the beams. NaN
Errors  + N(0, sd^2)                  white, each beam; no bias: the echo is strong, and of one target
        +- outlier                    on a share of the beams (a fish, the side lobe of another beam)
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.localisation.sensors.bottom_track import BottomTracking
from ltv_mpc.messages import Array, BottomTrack
from sim.random_streams import Stream, generator
from sim.sensors.adcp import Instrument
from sim.sensors.simulated import outliers
from sim.sensors.vehicle_state import VehicleState

_MIN_COSINE = math.cos(math.radians(70.0))


class BottomTracker:
    """Bottom track of a profiler."""

    def __init__(self, settings: BottomTracking, instrument: Instrument, bottom_m: float | None, seed: int) -> None:
        """Create a bottom track that draws noise, losses and outliers from a stream of its own.

        ``bottom_m`` is the depth of the sea bed; None: out of reach.
        """
        self._settings, self._instrument = settings, instrument
        self._bottom_m = math.inf if bottom_m is None else bottom_m
        self._draws = generator(seed, Stream.BOTTOM_TRACK)

    def sample(self, now: VehicleState) -> list[BottomTrack]:
        """Return one ping, also if no beam has found the bottom."""
        settings, lever = self._settings, self._instrument.settings.lever_arm_m
        u = self._instrument.beams @ now.rotation.T
        altitude = self._bottom_m - now.point_m(lever)[2]
        # Everything is drawn at every ping, so that no setting changes the random numbers of another.
        noise = self._draws.standard_normal(4)
        lost = self._draws.random(4) < settings.missing_share
        uniform = self._draws.random(4)
        lost |= (u[:, 2] < _MIN_COSINE) | (not 0.0 < altitude <= settings.range_m)
        velocity = u @ -np.array(now.point_velocity_mps(lever)) + settings.beam_noise_sd_mps * noise
        velocity += settings.outlier_mps * outliers(uniform, settings.outlier_share)
        velocity[lost] = np.nan
        slant: Array = np.full(4, np.nan)
        slant[~lost] = altitude / u[~lost, 2]
        return [BottomTrack(t_ns=now.t_ns, range_m=slant, beam_velocity_mps=velocity)]
