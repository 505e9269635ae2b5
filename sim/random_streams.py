"""Random streams: one for each part of the simulation, so that the draws of one part do not shift another's."""

from __future__ import annotations

import enum

import numpy as np


class Stream(enum.IntEnum):
    """Second word of a generator's seed. A number is never used again for something else."""

    WATER_NORTH = 101
    WATER_EAST = 102
    WATER_CHANGE_AFTER = 103
    WATER_CHANGE_BEFORE = 104
    SURFACE_WAVES = 105
    ATTITUDE = 201
    WIND = 202
    IMU = 301
    GNSS = 302
    TDCP = 303
    ADCP_INSTRUMENT = 304
    ADCP_PINGS = 305
    PRESSURE = 306
    COMPASS = 307
    BOTTOM_TRACK = 308
    LBL = 309
    USBL = 310


def generator(seed: int, stream: Stream) -> np.random.Generator:
    """Return the random generator of one part for the run's ``seed``."""
    return np.random.Generator(np.random.PCG64([seed, int(stream)]))
