"""Who draws from which stream of random numbers: one row each, so that no part's draws move another's."""

from __future__ import annotations

import enum

import numpy as np


class Stream(enum.IntEnum):
    """The second word of a generator's seed. Numbers are never used again for something else."""

    WATER_NORTH = 101
    WATER_EAST = 102
    WATER_CHANGE_AFTER = 103
    WATER_CHANGE_BEFORE = 104
    ATTITUDE = 201
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
    """The run's ``seed`` and the part's stream give the part's own random numbers."""
    return np.random.Generator(np.random.PCG64([seed, int(stream)]))
