"""From the instrument's coordinates and signs to the project's: velocity along four beams, their directions in NED.

RDI     b_i > 0: water comes towards transducer i. X, Y, Z of the instrument: Y to beam 3, Z out of its back, away from
        where it looks; X completes the right-handed three. With s = sin a, k = cos a of the beam angle a, and c = 1 for
        a convex head, -1 for a concave one:
            X = c (b1 - b2) / 2s,  Y = c (b4 - b3) / 2s,  Z = (b1 + b2 + b3 + b4) / 4k,
            E = (b1 + b2 - b3 - b4) / (2 sqrt(2) s)       error velocity, as noisy as X; it does not see a uniform flow
        [east, north, up] = M(H, P, Q) [X, Y, Z],  columns of M:
            X  [cos H cos Q + sin H sin P sin Q,  -sin H cos Q + cos H sin P sin Q,  -cos P sin Q]
            Y  [sin H cos P,  cos H cos P,  sin P]
            Z  [cos H sin Q - sin H sin P cos Q,  -sin H sin Q - cos H sin P cos Q,  cos P cos Q]
        P = atan(tan(pitch) cos(roll)): the tilt sensors are no gimbal;  Q = roll, + 180 deg where it looks up.
        Ship: H = 0. Tilts not used (EX): P = 0 and Q = 0 or 180 deg in what it computed, not in where it looked.
Ours    z_i = -b_i, positive away; u_i unit vectors from the transducer in NED; beams in the order ahead, astern,
        starboard, port (3, 4, 2, 1 looking down; 3, 4, 1, 2 looking up).
Back    b = T^-1 [X, Y, Z, E] with [X, Y, Z] = M^T [east, north, up]. Without E the instrument has used three beams
        and has set E = 0, which makes up the fourth: the beam of the lowest correlation is taken to be that one and
        left out (without correlations: the one furthest from the vertical).
Cells   middle of cell j at d_j = d_1 + j cell from the face. Mapped bins (EX) are at depth d_j below or above in every
        beam; else they are at d_j / cos a along each beam.
Not     heading alignment (EA) and bias (EB) are not applied: north is the north of the heading in the file. How the
        instrument is mounted in its vehicle is not in the file either; if the vehicle's attitude is what it wrote, the
        directions here are off by the mounting, and the velocities in earth coordinates are not.
Source  Teledyne RD Instruments, ADCP Coordinate Transformation, P/N 951-6079-00.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.localisation.pd0.records import BEAMS, Coordinates, Ensemble, Settings
from ltv_mpc.messages import Array

_ENU_TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


class BeamEnsemble(NamedTuple):
    """One ensemble in the project's terms. NaN where there is nothing."""

    t_ns: int
    depth_m: float  # of the transducer
    direction: Array  # u, (4, 3), NED
    velocity_mps: Array  # z, (4, cells)
    below_m: Array  # of the cell's middle below the transducer, (4, cells); negative above it
    good: Array  # share of the pings that went into the cell, (4, cells)
    echo: Array | None  # (4, cells), counts, by distance along the beam
    range_m: Array  # of the echo's cells along the beam, (cells,)
    bottom_mps: Array  # velocity of the instrument over ground, (3,), NED


def to_beams(ensemble: Ensemble) -> BeamEnsemble:
    """The project's view of an ensemble."""
    settings = ensemble.settings
    order = _order(settings)
    u = _directions(ensemble)[order]
    d = settings.first_cell_m + settings.cell_m * np.arange(settings.cells, dtype=np.float64)
    along = d / math.cos(settings.beam_angle_rad)
    if settings.bins_mapped and settings.tilts_used and settings.coordinates in (Coordinates.SHIP, Coordinates.EARTH):
        below = np.tile(-d if settings.upward else d, (BEAMS, 1))
    else:
        below = u[:, 2:] * along
    return BeamEnsemble(
        t_ns=ensemble.t_ns,
        depth_m=ensemble.depth_m,
        direction=u,
        velocity_mps=-_beam_velocities(ensemble)[:, order].T,
        below_m=below,
        good=_good(ensemble)[:, order].T,
        echo=None if ensemble.echo is None else ensemble.echo[:, order].T,
        range_m=along,
        bottom_mps=_over_ground(ensemble),
    )


def instrument_matrix(settings: Settings) -> Array:
    """T: beams 1 to 4 to X, Y, Z, E, (4, 4)."""
    a = 1 / (2 * math.sin(settings.beam_angle_rad))
    b = 1 / (4 * math.cos(settings.beam_angle_rad))
    c = 1.0 if settings.convex else -1.0
    d = a / math.sqrt(2)
    return np.array([[c * a, -c * a, 0, 0], [0, 0, -c * a, c * a], [b, b, b, b], [d, d, -d, -d]])


def earth_matrix(heading: float, pitch: float, roll: float, *, upward: bool) -> Array:
    """M(H, P, Q) of the file's angles: X, Y, Z to east, north, up, (3, 3)."""
    P = math.atan(math.tan(pitch) * math.cos(roll))
    Q = roll + math.pi if upward else roll
    (sh, ch), (sp, cp), (sq, cq) = ((math.sin(x), math.cos(x)) for x in (heading, P, Q))
    return np.array(
        [
            [ch * cq + sh * sp * sq, sh * cp, ch * sq - sh * sp * cq],
            [-sh * cq + ch * sp * sq, ch * cp, -sh * sq - ch * sp * cq],
            [-cp * sq, sp, cp * cq],
        ]
    )


def _order(settings: Settings) -> list[int]:
    """Beams ahead, astern, starboard, port, as indices of the file's."""
    sides = [0, 1] if settings.upward == settings.convex else [1, 0]
    return [2, 3, *sides] if settings.convex else [3, 2, *sides]


def _directions(ensemble: Ensemble) -> Array:
    """u of the file's beams 1 to 4, (4, 3), NED."""
    settings = ensemble.settings
    s, k = math.sin(settings.beam_angle_rad), math.cos(settings.beam_angle_rad)
    c = 1.0 if settings.convex else -1.0
    xyz = np.array([[-c * s, 0, -k], [c * s, 0, -k], [0, c * s, -k], [0, -c * s, -k]])
    M = earth_matrix(ensemble.heading_rad, ensemble.pitch_rad, ensemble.roll_rad, upward=settings.upward)
    return xyz @ (_ENU_TO_NED @ M).T


def _as_computed(ensemble: Ensemble) -> Array:
    """M as the instrument had it when it wrote ship or earth coordinates, (3, 3)."""
    settings = ensemble.settings
    heading = ensemble.heading_rad if settings.coordinates is Coordinates.EARTH else 0.0
    tilts = (ensemble.pitch_rad, ensemble.roll_rad) if settings.tilts_used else (0.0, 0.0)
    return earth_matrix(heading, *tilts, upward=settings.upward)


def _beam_velocities(ensemble: Ensemble) -> Array:
    """b, (cells, 4): what the instrument measured before it turned it."""
    settings, v = ensemble.settings, ensemble.velocity_mps
    if settings.coordinates is Coordinates.BEAM:
        return v
    xyz = v[:, :3]
    if settings.coordinates is not Coordinates.INSTRUMENT:
        xyz = xyz @ _as_computed(ensemble)  # M^T v, row by row
    three = np.isnan(v[:, 3]) & np.isfinite(v[:, :3]).all(axis=1)
    error = np.where(three, 0.0, v[:, 3])
    b: Array = np.column_stack([xyz, error]) @ np.linalg.inv(instrument_matrix(settings)).T
    if ensemble.correlation is not None:
        left_out = np.argmin(ensemble.correlation, axis=1)
    else:
        left_out = np.full(len(v), np.argmin(np.abs(_directions(ensemble)[:, 2])))
    b[three, left_out[three]] = np.nan
    return b


def _good(ensemble: Ensemble) -> Array:
    """Share of the pings in each velocity, (cells, 4); 1 where the file does not say."""
    percent = ensemble.percent_good
    if percent is None:
        return np.ones((ensemble.settings.cells, BEAMS))
    if ensemble.settings.coordinates is Coordinates.BEAM:
        return percent.clip(0, 100) / 100
    # three-beam and four-beam solutions
    share = (percent[:, 0] + percent[:, 3]).clip(0, 100) / 100
    return np.repeat(share[:, None], BEAMS, axis=1)


def _over_ground(ensemble: Ensemble) -> Array:
    """Minus the bottom's velocity past the instrument, (3,), NED."""
    if ensemble.bottom is None:
        return np.full(3, np.nan)
    settings, v = ensemble.settings, ensemble.bottom.velocity_mps
    M = earth_matrix(ensemble.heading_rad, ensemble.pitch_rad, ensemble.roll_rad, upward=settings.upward)
    match settings.coordinates:
        case Coordinates.EARTH if settings.tilts_used:
            enu = v[:3]
        case Coordinates.EARTH | Coordinates.SHIP:
            enu = M @ (_as_computed(ensemble).T @ v[:3])
        case Coordinates.INSTRUMENT:
            enu = M @ v[:3]
        case Coordinates.BEAM:
            enu = M @ (instrument_matrix(settings)[:3] @ _completed(v))
    over_ground: Array = -_ENU_TO_NED @ enu
    return over_ground


def _completed(b: Array) -> Array:
    """Four beams; one that is missing is what makes b1 + b2 = b3 + b4."""
    missing = np.flatnonzero(np.isnan(b))
    if len(missing) != 1:
        return b
    sign = np.array([1.0, 1.0, -1.0, -1.0])
    filled = b.copy()
    filled[missing] = -np.nansum(sign * b) / sign[missing]
    return filled
