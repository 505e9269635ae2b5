"""Writes PD0 ensembles: for tests of the reader alone. Fields as in the reader's source, formulas written down anew.

An ensemble is given by its four beams in the file's signs (b > 0: towards the transducer); the instrument's own
arithmetic to other coordinates is done here, with Euler rotations multiplied one by one.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import numpy as np

MISSING = -32768
BEAM, INSTRUMENT, SHIP, EARTH = range(4)
START = datetime(2016, 6, 23, 5, 19, 39, tzinfo=UTC)


@dataclass
class Head:
    """The fixed leader's settings."""

    frequency_kHz: int = 600
    upward: bool = False
    convex: bool = True
    beam_angle_deg: int = 30
    cells: int = 20
    cell_cm: int = 200
    first_cm: int = 294
    pings: int = 10
    coordinates: int = EARTH
    tilts_used: bool = True
    bins_mapped: bool = True


@dataclass
class Written:
    """One ensemble. ``beams_mps`` (cells, 4), NaN for a beam that was lost."""

    t_s: float
    beams_mps: np.ndarray
    heading_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    depth_m: float = 0.0
    number: int = 1
    pressure: bool = False
    correlation: np.ndarray | None = None
    echo: np.ndarray | None = None
    percent_good: np.ndarray | None = None
    bottom_beams_mps: np.ndarray | None = None
    bottom_range_m: np.ndarray = field(default_factory=lambda: np.full(4, 50.0))
    said_pitch_deg: float | None = None  # what the leader says, where that is the vehicle's and not the instrument's
    spare: bytes = b""  # a record that nobody knows


def about(axis: str, angle: float) -> np.ndarray:
    """Rotation about one axis of right-handed x, y, z."""
    c, s = math.cos(angle), math.sin(angle)
    return {
        "x": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


def to_earth(head: Head, heading_deg: float, pitch_deg: float, roll_deg: float) -> np.ndarray:
    """X, Y, Z to east, north, up: yaw clockwise about up, then nose up about starboard, then starboard down about Y."""
    pitch = math.atan(math.tan(math.radians(pitch_deg)) * math.cos(math.radians(roll_deg)))
    roll = math.radians(roll_deg) + (math.pi if head.upward else 0.0)
    return about("z", -math.radians(heading_deg)) @ about("x", pitch) @ about("y", roll)


def to_instrument(head: Head, b: np.ndarray) -> np.ndarray:
    """Beams (..., 4) to X, Y, Z, error; a lost beam is made up so that the error vanishes, which is then missing."""
    s, k = math.sin(math.radians(head.beam_angle_deg)), math.cos(math.radians(head.beam_angle_deg))
    c = 1 if head.convex else -1
    b1, b2, b3, b4 = np.moveaxis(b.copy(), -1, 0)
    lost = np.isnan(b).sum(axis=-1)
    b1 = np.where((lost == 1) & np.isnan(b1), b3 + b4 - b2, b1)
    b2 = np.where((lost == 1) & np.isnan(b2), b3 + b4 - b1, b2)
    b3 = np.where((lost == 1) & np.isnan(b3), b1 + b2 - b4, b3)
    b4 = np.where((lost == 1) & np.isnan(b4), b1 + b2 - b3, b4)
    error = (b1 + b2 - b3 - b4) / (2 * math.sqrt(2) * s)
    xyze = [c * (b1 - b2) / (2 * s), c * (b4 - b3) / (2 * s), (b1 + b2 + b3 + b4) / (4 * k)]
    return np.stack([*xyze, np.where(lost == 1, np.nan, error)], axis=-1)


def transformed(head: Head, ensemble: Written, b: np.ndarray) -> np.ndarray:
    """Beams (..., 4) as the instrument writes them."""
    if head.coordinates == BEAM:
        return b
    out = to_instrument(head, b)
    tilts = (ensemble.pitch_deg, ensemble.roll_deg) if head.tilts_used else (0.0, 0.0)
    if head.coordinates == SHIP:
        out[..., :3] = out[..., :3] @ to_earth(head, 0.0, *tilts).T
    if head.coordinates == EARTH:
        out[..., :3] = out[..., :3] @ to_earth(head, ensemble.heading_deg, *tilts).T
    return out


def _mm(v: np.ndarray) -> bytes:
    return np.where(np.isfinite(v), np.round(1000 * np.nan_to_num(v)), MISSING).astype("<i2").tobytes()


def _fixed(head: Head) -> bytes:
    code = {75: 0, 150: 1, 300: 2, 600: 3, 1200: 4, 2400: 5}[head.frequency_kHz]
    low = code | (0x08 if head.convex else 0) | 0x40 | (0x80 if head.upward else 0)
    high = {15: 0, 20: 1, 30: 2}.get(head.beam_angle_deg, 3) | 0x40
    transform = head.coordinates << 3 | head.tilts_used << 2 | 1 << 1 | head.bins_mapped
    record = bytearray(59)
    struct.pack_into("<HBBBB", record, 0, 0x0000, 51, 40, low, high)
    struct.pack_into("<BBHHH", record, 8, 4, head.cells, head.pings, head.cell_cm, 88)
    record[25] = transform
    struct.pack_into("<H", record, 32, head.first_cm)
    record[58] = head.beam_angle_deg
    return bytes(record)


def _variable(ensemble: Written) -> bytes:
    moment = START + timedelta(seconds=int(ensemble.t_s))
    hundredths = min(round(100 * (ensemble.t_s - int(ensemble.t_s))), 99)
    record = bytearray(65)
    struct.pack_into("<HH", record, 0, 0x0080, ensemble.number & 0xFFFF)
    clock = (moment.year % 100, moment.month, moment.day, moment.hour, moment.minute, moment.second, hundredths)
    struct.pack_into("<7BB", record, 4, *clock, ensemble.number >> 16)
    struct.pack_into("<HH", record, 14, 1500, round(10 * ensemble.depth_m))
    pitch_deg = ensemble.pitch_deg if ensemble.said_pitch_deg is None else ensemble.said_pitch_deg
    angles = (round(100 * a) for a in (ensemble.heading_deg, pitch_deg, ensemble.roll_deg))
    struct.pack_into("<Hhh", record, 18, *angles)
    if ensemble.pressure:
        struct.pack_into("<I", record, 48, round(1025 * 9.80665 * ensemble.depth_m / 10))
    return bytes(record)


def _bottom(head: Head, ensemble: Written) -> bytes:
    record = bytearray(85)
    struct.pack_into("<HH", record, 0, 0x0600, 5)
    cm = [round(100 * r) for r in ensemble.bottom_range_m]
    struct.pack_into("<4H", record, 16, *(x & 0xFFFF for x in cm))
    record[24:32] = _mm(transformed(head, ensemble, ensemble.bottom_beams_mps))
    record[40:44] = bytes([0, 0, 0, 100])
    record[77:81] = bytes(x >> 16 for x in cm)
    return bytes(record)


def written(head: Head, ensemble: Written) -> bytes:
    """Return the bytes of one ensemble, with its checksum."""
    shape = (head.cells, 4)
    velocity = transformed(head, ensemble, ensemble.beams_mps)
    four = np.isfinite(ensemble.beams_mps).all(axis=1)
    usual = np.zeros(shape)
    if head.coordinates == BEAM:
        usual = np.where(np.isfinite(ensemble.beams_mps), 100.0, 0.0)
    else:
        usual[:, 3], usual[:, 0] = 100.0 * four, 100.0 * (~four & np.isfinite(velocity[:, 0]))
    counts = (
        (0x0200, ensemble.correlation, np.where(np.isfinite(ensemble.beams_mps), 120.0, 10.0)),
        (0x0300, ensemble.echo, np.tile(np.linspace(110, 60, head.cells)[:, None], 4)),
        (0x0400, ensemble.percent_good, usual),
    )
    records = [_fixed(head), _variable(ensemble), struct.pack("<H", 0x0100) + _mm(velocity)]
    for identity, given, default in counts:
        record = default if given is None else given
        records.append(struct.pack("<H", identity) + record.astype(np.uint8).tobytes())
    if ensemble.bottom_beams_mps is not None:
        records.append(_bottom(head, ensemble))
    if ensemble.spare:
        records.append(ensemble.spare)
    place = 6 + 2 * len(records)
    offsets = []
    for record in records:
        offsets.append(place)
        place += len(record)
    frame = struct.pack(f"<BBHBB{len(offsets)}H", 0x7F, 0x7F, place + 2, 0, len(offsets), *offsets)
    frame += b"".join(records) + b"\0\0"
    return frame + struct.pack("<H", sum(frame) & 0xFFFF)
