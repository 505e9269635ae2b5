"""Conversion of PD0 coordinates and signs: velocities along four beams, and beam directions in NED.

RDI     b_i > 0: water moves towards transducer i. Instrument axes: Y to beam 3, Z opposite to the viewing direction, X
        completes the right-handed frame. With s = sin a, k = cos a of the beam angle a, and c = 1 for
        a convex head, -1 for a concave one:
            X = c (b1 - b2) / 2s,  Y = c (b4 - b3) / 2s,  Z = (b1 + b2 + b3 + b4) / 4k,
            E = (b1 + b2 - b3 - b4) / (2 sqrt(2) s)       error velocity, as noisy as X, 0 in a uniform flow
        [east, north, up] = M(H, P, Q) [X, Y, Z],  columns of M:
            X  [cos H cos Q + sin H sin P sin Q,  -sin H cos Q + cos H sin P sin Q,  -cos P sin Q]
            Y  [sin H cos P,  cos H cos P,  sin P]
            Z  [cos H sin Q - sin H sin P cos Q,  -sin H sin Q - cos H sin P cos Q,  cos P cos Q]
        P = atan(tan(pitch) cos(roll)): the tilt sensors are no gimbal;  Q = roll, + 180 deg if it looks up.
        Ship coordinates: H = 0. Tilts not used (EX): the instrument computed with P = 0 and Q = 0 or 180 deg.
Here    z_i = -b_i, positive away; u_i unit vectors from the transducer in NED; beams in the order ahead, astern,
        starboard, port (3, 4, 2, 1 looking down; 3, 4, 1, 2 looking up).
Inverse b = T^-1 [X, Y, Z, E] with [X, Y, Z] = M^T [east, north, up]. A missing E means a three-beam solution with
        E = 0, in which the fourth beam is not measured. It is taken to be the beam with the lowest correlation (without
        correlations: the one furthest from the vertical) and is left out.
Cells   The middle of cell j is at d_j = d_1 + j cell from the face. Mapped bins (EX) are at depth d_j below or above in
        every beam; others are at d_j / cos a along each beam.
Limits  Heading alignment (EA) and bias (EB) are not applied: north is the north of the heading in the file. The file
        does not contain the mounting of the instrument. If it records the vehicle's attitude, the beam directions here
        have the error of the mounting; velocities in earth coordinates do not.
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
    """Ensemble in beam coordinates and the signs of this project; NaN if missing."""

    t_ns: int
    settings: Settings
    depth_m: float  # of the transducer
    direction: Array  # u, (4, 3), NED
    velocity_mps: Array  # z, (4, cells)
    below_m: Array  # depth of the cell's middle below the transducer, (4, cells); negative above it
    good: Array  # share of good pings, (4, cells)
    echo: Array | None  # (4, cells), counts, by distance along the beam
    range_m: Array  # range of the cells along the beam, (cells,)
    bottom_mps: Array  # velocity of the instrument over ground, (3,), NED


def to_beams(ensemble: Ensemble) -> BeamEnsemble:
    """Convert an ensemble to beam coordinates and the signs of this project."""
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
        settings=settings,
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
    """Return T, from beams 1 to 4 to X, Y, Z, E, (4, 4)."""
    a = 1 / (2 * math.sin(settings.beam_angle_rad))
    b = 1 / (4 * math.cos(settings.beam_angle_rad))
    c = 1.0 if settings.convex else -1.0
    d = a / math.sqrt(2)
    return np.array([[c * a, -c * a, 0, 0], [0, 0, -c * a, c * a], [b, b, b, b], [d, d, -d, -d]])


def earth_matrix(heading: float, pitch: float, roll: float, *, upward: bool) -> Array:
    """Return M(H, P, Q), from X, Y, Z to east, north, up, (3, 3).

    Parameters
    ----------
    heading, pitch, roll : angles in the file (rad).
    upward : the instrument looks up.
    """
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
    """Return the file's beam indices in the order ahead, astern, starboard, port."""
    sides = [0, 1] if settings.upward == settings.convex else [1, 0]
    return [2, 3, *sides] if settings.convex else [3, 2, *sides]


def _directions(ensemble: Ensemble) -> Array:
    """Return the unit vectors of the file's beams 1 to 4, (4, 3), NED."""
    settings = ensemble.settings
    xyz = -np.linalg.inv(instrument_matrix(settings))[:, :3]  # water that moves away from the transducer has b < 0
    M = earth_matrix(ensemble.heading_rad, ensemble.pitch_rad, ensemble.roll_rad, upward=settings.upward)
    return xyz @ (_ENU_TO_NED @ M).T


def _as_computed(ensemble: Ensemble) -> Array:
    """Return the M with which the instrument computed ship or earth coordinates, (3, 3)."""
    settings = ensemble.settings
    heading = ensemble.heading_rad if settings.coordinates is Coordinates.EARTH else 0.0
    tilts = (ensemble.pitch_rad, ensemble.roll_rad) if settings.tilts_used else (0.0, 0.0)
    return earth_matrix(heading, *tilts, upward=settings.upward)


def _beam_velocities(ensemble: Ensemble) -> Array:
    """Return the velocities b along the file's beams, (cells, 4), as the instrument measured them."""
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
    """Return the share of good pings, (cells, 4); 1 if the file does not contain it."""
    percent = ensemble.percent_good
    if percent is None:
        return np.ones((ensemble.settings.cells, BEAMS))
    if ensemble.settings.coordinates is Coordinates.BEAM:
        return percent.clip(0, 100) / 100
    # three-beam and four-beam solutions
    share = (percent[:, 0] + percent[:, 3]).clip(0, 100) / 100
    return np.repeat(share[:, None], BEAMS, axis=1)


def _over_ground(ensemble: Ensemble) -> Array:
    """Return the velocity of the instrument over ground, (3,), NED: minus the bottom's relative velocity."""
    if ensemble.bottom_mps is None:
        return np.full(3, np.nan)
    settings, v = ensemble.settings, ensemble.bottom_mps
    M = earth_matrix(ensemble.heading_rad, ensemble.pitch_rad, ensemble.roll_rad, upward=settings.upward)
    match settings.coordinates:
        case Coordinates.EARTH | Coordinates.SHIP:
            enu = M @ (_as_computed(ensemble).T @ v[:3])
        case Coordinates.INSTRUMENT:
            enu = M @ v[:3]
        case Coordinates.BEAM:
            enu = M @ (instrument_matrix(settings)[:3] @ _completed(v))
    over_ground: Array = -_ENU_TO_NED @ enu
    return over_ground


def _completed(b: Array) -> Array:
    """Return four beam velocities (4,); a single missing one follows from b1 + b2 = b3 + b4."""
    missing = np.flatnonzero(np.isnan(b))
    if len(missing) != 1:
        return b
    sign = np.array([1.0, 1.0, -1.0, -1.0])
    filled = b.copy()
    filled[missing] = -np.nansum(sign * b) / sign[missing]
    return filled
