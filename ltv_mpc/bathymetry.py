"""Bathymetry: depth of the bottom from soundings, scattered or on a grid, in a table of comma-separated values.

Columns north_m, east_m and depth_m (below the surface, positive down; negative on land) in any order; or latitude_deg
and longitude_deg instead of north_m and east_m, relative to the [origin] of the mission's reference. Of several
soundings at one place the shallowest counts.

Between soundings the bottom is linear, in the triangles of their Delaunay triangulation: a rock between them is not
known. Outside the convex hull of all soundings the bottom is not known.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ltv_mpc.control.config import MotionLimits
from ltv_mpc.errors import ConfigError, naming
from ltv_mpc.messages import Array
from ltv_mpc.references.base import BaseReference
from ltv_mpc.references.geodesy import DEPTH, METRES, Origin, read_places

MAX_DRYING_M = 100.0
"""Largest height of land above the surface, a negative depth: charts have drying heights."""
MAX_SOUNDINGS = 100_000
"""Largest number of soundings: their triangulation takes some seconds."""


class Bathymetry:
    """Depth of the bottom, linear between soundings."""

    def __init__(self, soundings: Array) -> None:
        """Triangulate the soundings.

        Parameters
        ----------
        soundings : (K, 3) north, east and depth (m).

        Raises
        ------
        ValueError
            If no three soundings form a triangle.
        """
        from scipy.interpolate import LinearNDInterpolator  # as long as the start of a process
        from scipy.spatial import QhullError

        soundings = np.asarray(soundings, dtype=np.float64)
        by_depth = soundings[np.argsort(soundings[:, 2])]
        places, first = np.unique(by_depth[:, :2].round(3), axis=0, return_index=True)
        depth = by_depth[first, 2]
        try:
            self._interpolate = LinearNDInterpolator(places, depth)
        except (QhullError, ValueError):
            raise ValueError("needs three soundings that are not in one line") from None
        self.relief_m = float(np.ptp(depth))
        """Difference between the deepest and the shallowest sounding (m)."""

    @classmethod
    def load(cls, path: str, origin: Origin | None) -> Bathymetry:
        """Read the soundings of a file.

        Parameters
        ----------
        path : of the file.
        origin : of the mission's reference; None is allowed for soundings in metres.

        Raises
        ------
        ConfigError
            If the file cannot be read or a row is not valid; with line, column, value and bound.
        """
        source = f"bathymetry {path}"
        rows = read_places(
            Path(path),
            DEPTH,
            origin=origin,
            rows=(3, MAX_SOUNDINGS),
            what="bathymetry",
            source=source,
            least={DEPTH: -MAX_DRYING_M},
        )
        with naming(source):
            return cls(np.array([[row[name] for name in (*METRES, DEPTH)] for row in rows.values()]))

    def depths(self, places: Array) -> Array:
        """Return the depth of the bottom (P,) in m; NaN where it is not known.

        Parameters
        ----------
        places : (P, 2) north and east (m).
        """
        depth: Array = self._interpolate(places)
        return depth


def bathymetry_for(reference: BaseReference, limits: MotionLimits, path: str) -> Bathymetry | None:
    """Read the bathymetry of a mission, or return None for an empty path.

    Parameters
    ----------
    reference : its [origin] is that of soundings in degrees.
    limits : a bathymetry needs ``min_altitude_m``.
    path : as ``Bathymetry.load`` takes it.

    Raises
    ------
    ConfigError : the file cannot be read, or there is no least altitude.
    """
    if not path:
        return None
    least_altitude_m(limits)
    return Bathymetry.load(path, reference.origin)


def least_altitude_m(limits: MotionLimits) -> float:
    """Return the least altitude above the bottom (m).

    Parameters
    ----------
    limits : settings of the limits.

    Raises
    ------
    ConfigError : they have no least altitude.
    """
    if limits.min_altitude_m is None:
        raise ConfigError("controller settings", "[limits] min_altitude_m", "is missing: a bathymetry needs it")
    return limits.min_altitude_m
