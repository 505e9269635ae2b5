"""Depth limits: the vertical thrust keeps between a least depth and the largest one, and above the bottom.

With the settings of [controller.limits], and the bottom at depth + altitude of the newest estimate with an altitude,

    z_low = min_depth_m,    z_high = min(max_depth_m, bottom - min_altitude_m)

Near a limit the acceleration is bounded (exponential control barrier function, Nguyen & Sreenath 2016, with two poles
at -l), so that the vehicle comes to rest at the limit without overshoot:

    l^2 (z_low - z) - 2 l z'  <=  z''  <=  l^2 (z_high - z) - 2 l z'

From a steady speed w the vehicle begins to slow down at a distance of 2 w / l. The rate l is that of the depth law, or
smaller if the thruster brakes weakly. Where the limits contradict each other, the lower one is kept: the bottom is
harder than the surface.

With a bathymetry the bottom ahead counts, too, and the shallower one counts. With the bottom b_i at the place where the
vehicle is t_i from now at the earliest, it is so deep at most that it can rise in time:

    z <= b_i + w_up max(t_i - T, 0),    T = 6 / l

w_up is half the speed of an ascent at full thrust. The depth lags by 2 w_up / l behind a limit that rises at w_up, and
by 0.02 w_up / l at T after the limit has come to rest. The places are those of the previous plan, and the path of the
reference or the straight line to its point. Unknown places do not count.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.bathymetry import Bathymetry, least_altitude_m
from ltv_mpc.control.config import MotionLimits
from ltv_mpc.control.prediction import Start
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Estimate, Plan
from ltv_mpc.references.follower import Follower
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle
from ltv_mpc.vehicle.resistance import steady_speed

MIN_RATE_RADPS = 0.01
"""Smallest rate l: of a vehicle that cannot brake."""

SETTLING = 6.0
"""T l: the lag 2 w_up / l has shrunk to (2 + 6) exp(-6) w_up / l."""

CLIMB_SHARE = 0.5
"""w_up over the speed of an ascent at full thrust: the rest is for a wrong buoyancy and for a faster approach."""

PLACES, MAX_AHEAD_S = 100, 600.0
"""Number of places on the reference, and largest time until the vehicle is at the last one."""


class DepthLimits:
    """Depths between which the vehicle stays; the bottom is where an estimate has seen it last."""

    def __init__(self, vehicle: Vehicle, limits: MotionLimits, max_rate_radps: float) -> None:
        """Begin without a bottom.

        Parameters
        ----------
        vehicle : its vertical thruster brakes.
        limits : settings of the limits.
        max_rate_radps : largest rate l.
        """
        self._max_depth_m = math.inf if limits.max_depth_m is None else limits.max_depth_m
        self._limits = limits
        self._seen_m = self._max_depth_m  # largest depth above the bottom that was seen last
        self.bathymetry: Bathymetry | None = None
        """Soundings of the bottom, if there are any."""
        self._climb_mps, self._ahead_s = CLIMB_SHARE * ascent_speed_mps(vehicle), np.zeros(0)
        min_depth_m = -math.inf if limits.min_depth_m is None else limits.min_depth_m
        self.bounds = np.array([min_depth_m, self._max_depth_m, min(max_rate_radps, braking_rate_radps(vehicle))])
        """(3,) least and largest depth (m), infinite where there is none, and rate l (rad/s)."""

    @property
    def is_limited(self) -> bool:
        """True if there is a limit now."""
        return bool(np.isfinite(self.bounds[:2]).any())

    def limit_before(self, depth_m: float) -> float | None:
        """Return the limit (m) that keeps the vehicle from a depth; None if the depth lies within the limits.

        Parameters
        ----------
        depth_m : wanted depth (m).
        """
        least, largest, _ = self.bounds.tolist()
        if depth_m > largest:
            return float(largest)
        return float(least) if depth_m < least else None

    def update(self, estimate: Estimate) -> None:
        """Take in the bottom; without an altitude it stays where it was seen last.

        Parameters
        ----------
        estimate : newest plausible one.
        """
        least_m = self._limits.min_altitude_m
        if least_m is not None and estimate.altitude_m is not None and estimate.depth_m is not None:
            bottom_m = estimate.depth_m + estimate.altitude_m
            self._seen_m = self.bounds[1] = min(self._max_depth_m, bottom_m - least_m)

    def set_bathymetry(self, bathymetry: Bathymetry) -> None:
        """Keep the least altitude above the bottom of a bathymetry, too.

        Parameters
        ----------
        bathymetry : soundings of the bottom.

        Raises
        ------
        ConfigError : there is no least altitude.
        """
        least_altitude_m(self._limits)
        self.bathymetry = bathymetry
        # as long as the vehicle needs from the deepest to the shallowest sounding
        ahead_s = self._settling_s + bathymetry.relief_m / max(self._climb_mps, 1e-6)
        self._ahead_s = np.linspace(0.0, min(ahead_s, MAX_AHEAD_S), PLACES)

    @property
    def _settling_s(self) -> float:
        return SETTLING / float(self.bounds[2])

    def look_ahead(self, start: Start, previous: Plan | None, follower: Follower | None) -> None:
        """Take in the bottom of the bathymetry where the vehicle is and will be, if there is one.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        previous : plan of the cycle before.
        follower : of the reference, if it is followed.
        """
        if self.bathymetry is None:
            return
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
        bottom_m = float(np.fmin.reduce(self.bathymetry.depths(np.concatenate(places)) + climb_m, initial=math.inf))
        self.bounds[1] = min(self._seen_m, bottom_m - least_altitude_m(self._limits))


def braking_rate_radps(vehicle: Vehicle) -> float:
    """Return the largest rate l for which the thruster can brake: braking acceleration over largest speed.

    Slowing down from a steady speed w needs at most l w / e, so 63 % of the thrust is left for errors of the model.

    Parameters
    ----------
    vehicle : its vertical thruster and its net buoyancy; infinite for a surface craft.
    """
    if vehicle.heave is None:
        return math.inf
    thruster, heave = vehicle.thrusters[2], vehicle.heave
    rate = math.inf
    for drive_N, brake_N in (
        (thruster.max_N - vehicle.net_buoyancy_N, vehicle.net_buoyancy_N - thruster.min_N),  # down
        (vehicle.net_buoyancy_N - thruster.min_N, thruster.max_N - vehicle.net_buoyancy_N),  # up
    ):
        if drive_N > 0.0:
            speed_mps = steady_speed(drive_N, heave.linear_damping_kgps, heave.quadratic_damping_kgpm)
            rate = min(rate, brake_N / heave.mass_kg / speed_mps)
    return max(rate, MIN_RATE_RADPS)


def ascent_speed_mps(vehicle: Vehicle) -> float:
    """Return the steady speed of an ascent at full thrust (m/s); 0 if the vehicle cannot rise.

    Parameters
    ----------
    vehicle : its vertical thruster and its net buoyancy.
    """
    if vehicle.heave is None:
        return 0.0
    up_N, heave = vehicle.net_buoyancy_N - vehicle.thrusters[2].min_N, vehicle.heave
    return steady_speed(up_N, heave.linear_damping_kgps, heave.quadratic_damping_kgpm) if up_N > 0.0 else 0.0


@jit
def clip_to_depths(wanted: float, z: float, w: float, integral: float, bounds: Array, p: Coefficients) -> float:
    """Return the thrust (N) nearest to the wanted one with which the depth stays within its limits.

    Parameters
    ----------
    wanted : thrust of the depth law (N).
    z, w : depth (m) and sinking speed (m/s).
    integral : integral term of the depth law (N): what the model's buoyancy lacks.
    bounds : ``DepthLimits.bounds``.
    p : coefficients of the vehicle.
    """
    rate = bounds[2]
    # F3 = M_z z'' + (B - W) + (d_z + D_z |w|) w
    steady = p.net_buoyancy + (p.linear_heave + p.quadratic_heave * abs(w)) * w + integral
    low = steady + p.mass_heave * (rate * rate * (bounds[0] - z) - 2.0 * rate * w)
    high = steady + p.mass_heave * (rate * rate * (bounds[1] - z) - 2.0 * rate * w)
    return float(min(max(wanted, low), high))
