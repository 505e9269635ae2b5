"""Decoding of a PD0 ensemble: the bytes of a frame with a valid checksum become numbers with units.

Frame   7F 7F, bytes without checksum (u16), spare, number of data types n (u8), n offsets (u16), the data types, two
        reserved bytes, checksum (u16); all little-endian. A data type starts with its identity (u16).
Types   fixed leader 0000, variable leader 0080, velocity 0100, correlation 0200, echo 0300, percent good 0400, bottom
        track 0600; other types are skipped. Both leaders and velocity are required.
Units   velocities mm/s, -32768 if missing (NaN here); cells cm; depth dm; pressure 10 Pa;
        angles 0.01 deg.
Signs   as in the instrument: velocity TOWARDS the transducer is positive, in the coordinates of the EX byte.
        ``beams.py`` converts them.
Source  Teledyne RD Instruments, WorkHorse Commands and Output Data Format, P/N 957-6156-00, chapter on PD0.
"""

from __future__ import annotations

import itertools
import math
import struct
from datetime import UTC, datetime
from enum import Enum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.frames import GRAVITY_MPS2
from ltv_mpc.messages import Array

MISSING = -32768
BEAMS = 4
HEADER = 6
MAX_DEPTH_M = 12_000.0
"""Largest valid depth (m). A larger depth or pressure is ignored."""
SEA_WATER_KGPM3 = 1025.0
_KILOHERTZ = {0: 75, 1: 150, 2: 300, 3: 600, 4: 1200, 5: 2400, 6: 38}
_ANGLE_DEG = {0: 15, 1: 20, 2: 30}

Bytes = npt.NDArray[np.uint8]


class Coordinates(Enum):
    """Coordinates of the four velocities of a cell."""

    BEAM = 0  # beams 1 to 4
    INSTRUMENT = 1  # X, Y, Z, error
    SHIP = 2  # starboard, forward, mast, error
    EARTH = 3  # east, north, up, error


HEAD = ("frequency_kHz", "upward", "convex", "beam_angle_rad")
"""Settings that belong to the transducer head. All others may change within a dive."""


class Settings(NamedTuple):
    """Instrument settings (fixed leader). Distances are perpendicular to the transducer face, not along a beam."""

    frequency_kHz: int
    upward: bool
    convex: bool
    beam_angle_rad: float
    cells: int
    pings: int
    cell_m: float
    first_cell_m: float  # to the middle of the first cell
    coordinates: Coordinates
    tilts_used: bool
    bins_mapped: bool
    heading_alignment_rad: float
    heading_bias_rad: float

    @property
    def setup(self) -> Settings:
        """Setup of the measurement: the settings without the first cell, which moves with the speed of sound."""
        return self._replace(first_cell_m=0.0)

    def same_instrument(self, other: Settings) -> bool:
        """Return True if both are settings of one instrument; cells, pings and coordinates may differ.

        Parameters
        ----------
        other : settings of another ensemble.
        """
        return all(getattr(self, name) == getattr(other, name) for name in HEAD)


class Ensemble(NamedTuple):
    """Decoded ensemble. Records that the file does not contain are None."""

    offset: int  # of its first byte in the file
    size: int  # bytes with the checksum
    number: int
    t_ns: int  # instrument clock, since 1970
    settings: Settings
    heading_rad: float
    pitch_rad: float  # of the tilt sensor, not a gimbal angle
    roll_rad: float
    depth_m: float
    velocity_mps: Array  # (cells, 4)
    correlation: Array | None  # (cells, 4), counts
    echo: Array | None  # (cells, 4), counts of about 0.45 dB
    percent_good: Array | None  # (cells, 4)
    bottom_mps: Array | None  # (4,) of the bottom, in the coordinates of the ensemble; NaN if missing


class DamagedEnsemble(ValueError):
    """Frame with a valid checksum and invalid content."""


def decode(frame: memoryview, offset: int) -> Ensemble:
    """Decode a frame.

    Parameters
    ----------
    frame : bytes from 7F 7F up to the checksum, without it.
    offset : offset of the frame in the file.

    Raises
    ------
    DamagedEnsemble
        If the content is invalid, with the reason.
    """
    records = _records(frame)
    settings = _settings(_needed(records, 0x0000, 42, "fixed leader"))
    leader = _needed(records, 0x0080, 28, "variable leader")
    heading, pitch, roll = (math.radians(x / 100) for x in struct.unpack_from("<Hhh", leader, 18))
    if not (heading <= 2 * math.pi and abs(pitch) < math.pi / 2 and abs(roll) <= math.pi):
        raise DamagedEnsemble("heading, pitch or roll is outside its range")
    velocity = _needed(records, 0x0100, 2 + 2 * BEAMS * settings.cells, "velocity")
    return Ensemble(
        offset=offset,
        size=len(frame) + 2,
        number=struct.unpack_from("<H", leader, 2)[0] + (leader[11] << 16),
        t_ns=_time(leader),
        settings=settings,
        heading_rad=heading,
        pitch_rad=pitch,
        roll_rad=roll,
        depth_m=_depth(leader),
        velocity_mps=_velocities(velocity, 2, BEAMS * settings.cells).reshape(settings.cells, BEAMS),
        correlation=_counts(records, 0x0200, settings.cells),
        echo=_counts(records, 0x0300, settings.cells),
        percent_good=_counts(records, 0x0400, settings.cells),
        bottom_mps=_bottom(records),
    )


def _records(frame: memoryview) -> dict[int, memoryview]:
    """Return the records by identity, each up to the start of the next; of two with one identity the first."""
    count = frame[5]
    first = HEADER + 2 * count
    if first > len(frame):
        raise DamagedEnsemble(f"{count} data types do not fit into {len(frame)} bytes")
    places = struct.unpack_from(f"<{count}H", frame, HEADER)
    ends = dict(itertools.pairwise([*sorted(set(places)), len(frame)]))
    found: dict[int, memoryview] = {}
    for place in places:
        if not first <= place <= len(frame) - 2:
            raise DamagedEnsemble(f"data type at offset {place} of {len(frame)} bytes")
        found.setdefault(struct.unpack_from("<H", frame, place)[0], frame[place : ends[place]])
    return found


def _needed(records: dict[int, memoryview], identity: int, min_bytes: int, name: str) -> memoryview:
    record = records.get(identity)
    if record is None:
        raise DamagedEnsemble(f"no {name}")
    if len(record) < min_bytes:
        raise DamagedEnsemble(f"{name} cut off after {len(record)} of {min_bytes} bytes")
    return record


def _settings(leader: memoryview) -> Settings:
    low, high = leader[4], leader[5]
    beams, cells, transform = leader[8], leader[9], leader[25]
    pings, cell_cm = struct.unpack_from("<HH", leader, 10)
    (first_cm,) = struct.unpack_from("<H", leader, 32)
    alignment, bias = struct.unpack_from("<hh", leader, 26)
    angle_deg = _ANGLE_DEG.get(high & 0b11)
    if angle_deg is None:  # "other": newer leaders contain the angle
        angle_deg = leader[58] if len(leader) > 58 else 0
    if beams != BEAMS:
        raise DamagedEnsemble(f"{beams} beams: only instruments with {BEAMS} are read")
    if low & 0b111 not in _KILOHERTZ:
        raise DamagedEnsemble(f"unknown frequency code {low & 0b111}")
    if not 5 <= angle_deg <= 45:
        raise DamagedEnsemble(f"beam angle {angle_deg} deg, must be 5 to 45")
    if not (cells and pings and cell_cm and first_cm):
        raise DamagedEnsemble("no cells, pings, cell length or first cell in the fixed leader")
    return Settings(
        frequency_kHz=_KILOHERTZ[low & 0b111],
        upward=bool(low & 0x80),
        convex=bool(low & 0x08),
        beam_angle_rad=math.radians(angle_deg),
        cells=cells,
        pings=pings,
        cell_m=cell_cm / 100,
        first_cell_m=first_cm / 100,
        coordinates=Coordinates(transform >> 3 & 0b11),
        tilts_used=bool(transform & 0b100),
        bins_mapped=bool(transform & 0b001),
        heading_alignment_rad=math.radians(alignment / 100),
        heading_bias_rad=math.radians(bias / 100),
    )


def _time(leader: memoryview) -> int:
    year, month, day, hour, minute, second, hundredth = leader[4:11]
    try:
        moment = datetime(1900 + year if year >= 80 else 2000 + year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        raise DamagedEnsemble("its clock is not a valid date") from None
    return int(moment.timestamp()) * 1_000_000_000 + hundredth * 10_000_000


def _depth(leader: memoryview) -> float:
    """Return the depth from pressure if available, because it is finer, else the depth of the transducer (ED)."""
    if len(leader) >= 52:
        # p = rho g z, in units of 10 Pa
        depth_m: float = 10.0 * struct.unpack_from("<I", leader, 48)[0] / (SEA_WATER_KGPM3 * GRAVITY_MPS2)
        if 0.0 < depth_m <= MAX_DEPTH_M:
            return depth_m
    return float(struct.unpack_from("<H", leader, 16)[0]) / 10


def _velocities(record: memoryview, start: int, count: int) -> Array:
    raw = np.frombuffer(record, dtype="<i2", count=count, offset=start)
    return np.where(raw == MISSING, np.nan, raw / 1000.0)


def _counts(records: dict[int, memoryview], identity: int, cells: int) -> Array | None:
    record = records.get(identity)
    if record is None or len(record) < 2 + BEAMS * cells:
        return None
    raw = np.frombuffer(record, dtype=np.uint8, count=BEAMS * cells, offset=2)
    return raw.reshape(cells, BEAMS).astype(np.float64)


def _bottom(records: dict[int, memoryview]) -> Array | None:
    record = records.get(0x0600)
    return None if record is None or len(record) < 44 else _velocities(record, 24, BEAMS)
