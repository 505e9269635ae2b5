"""Check of a reference against the soundings of a bathymetry."""

from __future__ import annotations

import msgspec
import numpy as np

from ltv_mpc.bathymetry import Bathymetry
from ltv_mpc.references.schedule import Schedule
from services.tools.path_samples import sample


class BottomCheck(msgspec.Struct, frozen=True, kw_only=True):
    """Altitude of the reference above the bottom of a bathymetry, where it is least."""

    altitude_m: float  # negative: below the bottom
    depth_m: float  # of the reference
    way_m: float  # distance along the path
    north_m: float
    east_m: float
    too_deep_m: float  # length of the path on which the altitude is less than min_altitude_m
    unknown_m: float  # length of the path on which the bottom is not known

    @property
    def place(self) -> str:
        """Place where the altitude is least, as text."""
        return f"at {self.way_m:.0f} m of the path (north {self.north_m:.0f} m, east {self.east_m:.0f} m)"


def check_bottom(
    bathymetry: Bathymetry, schedule: Schedule, min_altitude_m: float
) -> tuple[BottomCheck | None, list[str]]:
    """Return where the altitude of a reference is least, and what is wrong with it.

    Parameters
    ----------
    bathymetry : soundings of the bottom.
    schedule : motion of the target, or a point as a schedule of one place.
    min_altitude_m : altitude that is kept (m).

    Returns
    -------
    None if the reference has no depth, or the bottom is not known below it; and the problems.
    """
    path = sample(schedule.table)
    if np.isnan(path.depth).all():
        return None, []
    altitude = bathymetry.depths(path.points) - path.depth
    if np.isnan(altitude).all():
        return None, ["the bathymetry does not reach the reference"]
    k = int(np.nanargmin(altitude))
    bottom = BottomCheck(
        altitude_m=float(altitude[k]),
        depth_m=float(path.depth[k]),
        way_m=float(path.way[k]),
        north_m=float(path.points[k, 0]),
        east_m=float(path.points[k, 1]),
        too_deep_m=path.length_where(altitude < min_altitude_m),
        unknown_m=path.length_where(np.isnan(altitude)),
    )
    problems = []
    if bottom.altitude_m < min_altitude_m:
        problems.append(
            f"the reference is too deep for {bottom.too_deep_m:.1f} m of the path, by up to "
            f"{min_altitude_m - bottom.altitude_m:.1f} m {bottom.place}: depth {bottom.depth_m:.1f} m, bottom "
            f"{bottom.depth_m + bottom.altitude_m:.1f} m, min_altitude_m = {min_altitude_m:g}"
        )
    if bottom.unknown_m > 0.0:
        problems.append(f"the bathymetry does not reach {bottom.unknown_m:.1f} m of the path")
    return bottom, problems
