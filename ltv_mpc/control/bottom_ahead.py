"""Bottom ahead: how deep the vehicle may be now so that it can rise above the bottom of a bathymetry in time.

With the bottom b_i at the place where the vehicle is t_i from now at the earliest,

    z <= b_i + w_up max(t_i - T, 0),    T = 6 / l

w_up is half the speed of an ascent at full thrust, and l the rate of the depth limits (``depth_limits.py``). The depth
lags by 2 w_up / l behind a limit that rises at w_up, and by 0.02 w_up / l at T after the limit has come to rest. The
places are those of the previous plan, and the path of the reference or the straight line to its point. Unknown places
do not count.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.bathymetry import Bathymetry
from ltv_mpc.control.prediction import Start
from ltv_mpc.messages import Array, Plan
from ltv_mpc.references.follower import Follower

SETTLING = 6.0
"""T l: the lag 2 w_up / l has shrunk to (2 + 6) exp(-6) w_up / l."""

CLIMB_SHARE = 0.5
"""w_up over the speed of an ascent at full thrust: the rest is for a wrong buoyancy and for a faster approach."""

PLACES, MAX_AHEAD_S = 100, 600.0
"""Number of places on the reference, and largest time until the vehicle is at the last one."""


class BottomAhead:
    """Bottom of a bathymetry where one vehicle is and will be."""

    def __init__(self, bathymetry: Bathymetry, ascent_mps: float, rate_radps: float) -> None:
        """Choose how far to look ahead: as long as the vehicle needs from the deepest to the shallowest sounding.

        Parameters
        ----------
        bathymetry : soundings of the bottom.
        ascent_mps : speed of an ascent at full thrust (m/s).
        rate_radps : rate l of the depth limits (rad/s).
        """
        self._bathymetry = bathymetry
        self._climb_mps = CLIMB_SHARE * ascent_mps
        self._settling_s = SETTLING / rate_radps
        ahead_s = self._settling_s + bathymetry.relief_m / max(self._climb_mps, 1e-6)
        self._ahead_s: Array = np.linspace(0.0, min(ahead_s, MAX_AHEAD_S), PLACES)

    def bottom_m(self, start: Start, previous: Plan | None, follower: Follower | None) -> float:
        """Return the largest depth (m) from which the vehicle can rise in time; infinite if no place is known.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        previous : plan of the cycle before.
        follower : of the reference, if it is followed.
        """
        places: list[Array] = [start.lateral[None, :2]]
        seconds: list[Array] = [np.zeros(1)]
        if previous is not None:
            places.append(previous.states[:, :2])
            seconds.append(np.asarray((previous.t_ns - start.t_ns) * 1e-9, dtype=np.float64))
        current = start.current_north_mps, start.current_east_mps
        ahead = None if follower is None else follower.places_ahead(start.lateral, current, self._ahead_s)
        if ahead is not None:
            places.append(ahead)
            seconds.append(self._ahead_s)
        climb_m = self._climb_mps * np.maximum(np.concatenate(seconds) - self._settling_s, 0.0)
        # fmin passes over NaN, where the bottom is not known.
        return float(np.fmin.reduce(self._bathymetry.depths(np.concatenate(places)) + climb_m, initial=math.inf))
