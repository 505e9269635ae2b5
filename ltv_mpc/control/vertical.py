"""Depth law of the vertical thruster: it holds a depth, or follows a ramp to one.

With depth error e = z_ref - z, rate error e' = w_ref - w, and the model's M_z, d_z, D_z and B - W:

    F3 = (B - W) + (d_z + D_z |w_ref|) w_ref  +  M_z (w0^2 e + 2 zeta w0 e') + integral of M_z w0^2 / T_i e

inside box, slew and depth limits (``depth_limits.py``). On a steady ramp the feed-forward is the whole thrust; in the
paper's descent it is the thruster's maximum.

The integral stands for the buoyancy that the model lacks. It is conditional (anti-windup): it stops while the command
is limited, and while a large error is being closed; beyond a depth limit it integrates the distance to it. While the
vehicle is blocked (afloat, aground, held) it is what it was before. If the buoyancy itself then
pushes the vehicle to a depth near by, the thrust fades to zero: a hull at the surface needs none, and a thrust down
would only keep it from rising. A new reference starts with an integral of zero.

A vehicle is blocked if it does not move in depth although the law pushes it. At rest, an error of the modelled buoyancy
and the force of the surface, the bottom or a line look alike. They differ in what the integral of the law achieves: it
moves the vehicle against a wrong buoyancy, and never against a stop. Let z1, z2, z3 be the mean depths of successive
intervals of length T, and e the mean depth error of the last one:

    blocked   if z1, z2, z3 are within min(|e| / 4, 0.1 m), and the law pushed to one side all the time
    free      if the law pushes to the other side, or the depth leaves z3 by twice that
    T         1.5 (2 zeta / w0 + d_z / (M_z w0^2)), the time in which the law closes an error: 10 s without damping d_z

Two intervals would not do: an error that passes through its maximum has the same mean before and after. The means
remove the noise of the depth and the waves.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from ltv_mpc.control.config import MotionLimits
from ltv_mpc.control.depth_limits import DepthLimits, clip_to_depths
from ltv_mpc.control.prediction import Start
from ltv_mpc.control.problem_data import STAGE_S, Constants
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Estimate, Times
from ltv_mpc.vehicle.dynamics import coefficients
from ltv_mpc.vehicle.flow import advance_heave
from ltv_mpc.vehicle.parameters import Vehicle

NATURAL_RADPS = 0.3
"""w0: slow against the thruster's lag, fast against a descent."""

DAMPING = 1.0
"""zeta: no overshoot."""

INTEGRAL_S = 20.0
"""T_i: several times 1 / w0, so that the integral only compensates what the feed-forward lacks."""

MAX_STEP_M = 1.0
"""Depth error above which it is integrated only if it lasts: a step of the reference is closed within 2 T_i, the error
of a wrong buoyancy is not.
"""

LEAD_S = 2.0 * DAMPING / NATURAL_RADPS
"""Lead of the law over the reference: it pushes to e + LEAD_S e'."""

RELIEF = 5.0
"""Rate at which the thrust of a blocked vehicle fades, over that of the integral. It grows with the depth error, so a
vehicle that is taken to be blocked by mistake moves away slowly, and is free again.
"""

MAX_INTEGRATION_S = 2.0
"""Longest time between two plans that is integrated: over a longer interruption the depth error is not constant."""


@jit
def follow_depth(
    o: Constants, at: Array, z_ref: Array, w_ref: Array, bounds: Array, blocked: float = 0.0, relief: float = 0.0
) -> tuple[Array, Array, float]:
    """Simulate the depth law over the horizon.

    Parameters
    ----------
    o : constants of the controller.
    at : (5,) at the first knot: depth (m), sinking speed (m/s), delivered thrust, command in force and integral (N).
    z_ref, w_ref : (N+1,) reference depths (m) and sinking speeds (m/s) at the knots. Without a reference ``z_ref`` is
        NaN, and ``w_ref`` holds the commands to keep (N).
    bounds : (3,) ``DepthLimits.bounds``.
    blocked : ``BlockedMotion.direction``; the vehicle stays where it is until the reference lies on the other side.
    relief : decrease of the thrust (N) that pushes a blocked vehicle away from its reference, against its buoyancy.

    Returns
    -------
    Depths (N+1,) in m, commands (N+1,) in N, and the integral's rate at the first knot (N/s).
    """
    p, t = coefficients(o.p), o.t
    low, high, slew = o.vertical[0], o.vertical[1], o.vertical[2]
    z, w, F, command, integral = at
    N = len(z_ref) - 1
    depth, commands = np.empty(N + 1), np.empty(N + 1)
    depth[0], commands[0] = z, command
    rate_now = 0.0
    for k in range(N):
        # The law acts at least every STAGE_S, also where the knots are farther apart; the plan samples it at the knots.
        acts = int(np.ceil(t[k + 1] - t[k] - 1e-9))
        h = (t[k + 1] - t[k]) * STAGE_S / acts
        for j in range(1, acts + 1):
            part = j / acts
            depth_ref = z_ref[k] + part * (z_ref[k + 1] - z_ref[k])
            rate_ref = w_ref[k] + part * (w_ref[k + 1] - w_ref[k])
            if blocked != 0.0:
                w = 0.0
                if blocked * (depth_ref - z + LEAD_S * rate_ref) <= 0.0:
                    blocked = 0.0
            e, rate = depth_ref - z, rate_ref - w
            # F3 = (B - W) + (d_z + D_z |w_ref|) w_ref + M_z (w0^2 e + 2 zeta w0 e') + integral
            feed = p.net_buoyancy + (p.linear_heave + p.quadratic_heave * abs(rate_ref)) * rate_ref
            pull = NATURAL_RADPS * NATURAL_RADPS * e + 2.0 * DAMPING * NATURAL_RADPS * rate
            wanted = feed + p.mass_heave * pull + integral
            if np.isnan(e):
                wanted, e = rate_ref, 0.0
            if blocked * p.net_buoyancy < 0.0 and abs(e) <= MAX_STEP_M:
                wanted = blocked * min(blocked * wanted + relief, 0.0)
            within = clip_to_depths(wanted, z, w, integral, bounds, p)
            if within != wanted:
                e = min(bounds[1] - z, 0.0) if within < wanted else max(bounds[0] - z, 0.0)
            limited = min(max(within, low, command - slew * h), high, command + slew * h)
            lasting = abs(e) <= MAX_STEP_M or abs(e) > 2.0 * INTEGRAL_S * abs(rate)
            if limited == within and lasting and blocked == 0.0:
                growth = p.mass_heave * NATURAL_RADPS * NATURAL_RADPS / INTEGRAL_S * e
                integral += growth * h
                if k == 0 and j == 1:
                    rate_now = growth
            place = z
            z, w, F = advance_heave(z, w, F, command, limited, h, p)
            if blocked != 0.0:
                z = place
            command = limited
        depth[k + 1], commands[k + 1] = z, command
    return depth, commands, rate_now


class VerticalPlan(NamedTuple):
    """Vertical part of a plan, at the knots."""

    depth_m: Array  # (N+1,) predicted
    thrust_N: Array  # (N+1,) commands
    integral_rate_N_per_s: float  # at the first knot; the time to the next plan is not known yet


class VerticalLaw:
    """Depth law of the vertical thruster, with its integral.

    The integral advances from the start of one plan to the start of the next.
    """

    def __init__(self, vehicle: Vehicle, constants: Constants, limits: MotionLimits) -> None:
        """Begin with a zero integral.

        Parameters
        ----------
        vehicle : its vertical thruster's slew limit is used.
        constants : of the controller.
        limits : settings of the depth limits.
        """
        self.depth_limits = DepthLimits(vehicle, limits, NATURAL_RADPS)
        """Depths between which the law stays."""
        self._slew_N_per_s = vehicle.thrusters[2].slew_N_per_s
        self._constants = constants
        p = vehicle.coefficients()
        self._stiffness_Npm = p.mass_heave * NATURAL_RADPS * NATURAL_RADPS
        self._blocked = BlockedMotion(LEAD_S + p.linear_heave / self._stiffness_Npm)
        self._relief_N = 0.0
        self.integral_N = 0.0
        """Integral term of the law (N)."""
        self.held_m: float | None = None
        """Depth that ``hold`` keeps (m); None: that of its next call."""
        self._integrated_ns: int | None = None

    def track(self, start: Start, estimate: Estimate, depth_m: Array, sinking_mps: Array) -> VerticalPlan:
        """Follow a depth reference.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        estimate : the estimate from which that was predicted; the prediction does not know what blocks the vehicle.
        depth_m : (N+1,) reference depths at the knots (m).
        sinking_mps : (N+1,) reference sinking speeds at the knots (m/s).

        Returns
        -------
        The commands and the predicted depths.
        """
        blocked, seen_m = self._blocked, start.depth_m if estimate.depth_m is None else estimate.depth_m
        low_m, high_m, _ = self.depth_limits.bounds.tolist()
        error_m = min(max(float(depth_m[0]), low_m), high_m) - seen_m
        blocked.update(estimate.t_ns, seen_m, error_m, LEAD_S * float(sinking_mps[0]), self.integral_N)
        if blocked.direction == 0.0:
            self._relief_N = 0.0
        else:
            start, self.integral_N = start._replace(depth_m=seen_m), blocked.integral_N
            self._relief_N += RELIEF * self._stiffness_Npm / INTEGRAL_S * abs(error_m) * self._seconds_to(start.t_ns)
        return self._simulate(start, depth_m, sinking_mps, blocked.direction)

    def _simulate(self, start: Start, depth_m: Array, rate: Array, blocked: float) -> VerticalPlan:
        """Return the plan of ``follow_depth``, with ``rate`` as its ``w_ref``."""
        at = start.depth_m, start.sinking_mps, start.vertical_N, start.vertical_command_N, self.integral_N
        bounds = self.depth_limits.bounds
        return VerticalPlan(
            *follow_depth(self._constants, np.array(at), depth_m, rate, bounds, blocked, self._relief_N)
        )

    def hold(self, start: Start, estimate: Estimate, knots: Times) -> VerticalPlan:
        """Keep the depth at which the hold began.

        Parameters
        ----------
        start, estimate : as ``track`` takes them.
        knots : (N+1,) times of the knots (ns).

        Returns
        -------
        The commands and the predicted depths.
        """
        if self.held_m is None:
            self.held_m = start.depth_m
        return self.track(start, estimate, np.full(len(knots), self.held_m), np.zeros(len(knots)))

    def ramp_to(self, start: Start, knots: Times, goal: Array) -> VerticalPlan:
        """Move the vertical thruster towards given commands at the slew limit.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        knots : (N+1,) times of the knots (ns).
        goal : (N+1,) wanted commands (N).

        Returns
        -------
        The commands; the depth is taken to stay that of the start.
        """
        thrust = ramp(start.vertical_command_N, goal, knots, self._slew_N_per_s)
        return VerticalPlan(np.full(len(knots), start.depth_m), thrust, 0.0)

    def keep(self, start: Start, thrust_N: Array) -> VerticalPlan:
        """Keep commands that are in force already, as far as the depth limits allow.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        thrust_N : (N+1,) commands at the knots (N).

        Returns
        -------
        The commands; without depth limits the depth is taken to stay that of the start.
        """
        if self.depth_limits.is_limited and not math.isnan(start.depth_m):
            return self._simulate(start, np.full(len(thrust_N), math.nan), thrust_N, 0.0)
        return VerticalPlan(np.full(len(thrust_N), start.depth_m), thrust_N, 0.0)

    def restart(self) -> None:
        """Begin another reference, with a zero integral."""
        self.integral_N = 0.0
        self._blocked.restart()

    def advance_integral(self, plan: VerticalPlan, start_ns: int) -> None:
        """Integrate the depth error from the start of the last plan to the start of this one.

        Parameters
        ----------
        plan : the plan of this cycle.
        start_ns : its start, vehicle time (ns).
        """
        self.integral_N += plan.integral_rate_N_per_s * self._seconds_to(start_ns)
        self._integrated_ns = start_ns

    def _seconds_to(self, start_ns: int) -> float:
        """Return the time (s) from the start of the last plan to this one's, at most ``MAX_INTEGRATION_S``."""
        since_ns = start_ns if self._integrated_ns is None else self._integrated_ns
        return min(max(start_ns - since_ns, 0) * 1e-9, MAX_INTEGRATION_S)


def ramp(start: float, goal: Array, knots: Times, slew_N_per_s: float) -> Array:
    """Return the commands of one thruster that approach a goal no faster than the slew limit.

    Parameters
    ----------
    start : command in force at the first knot (N).
    goal : (N+1,) wanted commands (N).
    knots : (N+1,) times of the knots (ns).
    slew_N_per_s : slew limit (N/s).

    Returns
    -------
    (N+1,) commands at the knots (N).
    """
    thrust = np.empty(len(knots))
    thrust[0] = start
    for k, reach in enumerate(np.diff(knots) * (1e-9 * slew_N_per_s)):
        thrust[k + 1] = thrust[k] + min(max(goal[k + 1] - thrust[k], -reach), reach)
    return thrust


INTERVALS = 3
"""Number of intervals without motion."""

SETTLING_FACTOR = 1.5
"""Length of an interval over the settling time of the depth law."""

MAX_SHARE = 0.25
"""Largest motion of a blocked vehicle over its depth error. The integral closes more than half of it in this time."""

MAX_MOTION_M = 0.1
"""Largest motion of a blocked vehicle: one with a weak thruster moves slowly where it is far from its depth."""

MIN_RELEASE_M = 0.02
"""Smallest motion that ends a block: above the noise of a depth sensor."""


class BlockedMotion:
    """Direction in which the vehicle is blocked, from depth and depth error in successive cycles."""

    def __init__(self, settling_s: float) -> None:
        """Begin with a vehicle that is free.

        Parameters
        ----------
        settling_s : settling time of the depth law (s).
        """
        self._interval_ns = round(SETTLING_FACTOR * settling_s * 1e9)
        self._past: deque[tuple[float, float]] = deque(maxlen=INTERVALS)  # mean depth, integral at its beginning
        self._t_ns = 0  # of the last cycle
        self.restart()

    def restart(self) -> None:
        """Begin with a vehicle that is free."""
        self.direction = 0.0
        """1 if the vehicle cannot sink to its reference, -1 if it cannot rise to it, 0 if it is free."""
        self.integral_N = 0.0
        """Integral of the depth law before the vehicle came to rest (N), while it is blocked."""
        self._side = 0.0  # the direction in which the law pushes
        self._place_m = self._reach_m = 0.0  # where the vehicle is blocked, and how far it may move there
        self._past.clear()

    def update(self, t_ns: int, depth_m: float, error_m: float, lead_m: float, integral_N: float) -> None:
        """Take in one cycle.

        Parameters
        ----------
        t_ns : time of the depth (ns).
        depth_m : depth of the vehicle (m).
        error_m : depth that the vehicle should have, within its limits, minus ``depth_m`` (m).
        lead_m : lead of the reference over its depth by its sinking speed (m).
        integral_N : integral of the depth law (N).
        """
        side = math.copysign(1.0, error_m + lead_m)
        if side != self._side or not 0 <= t_ns - self._t_ns < self._interval_ns:
            self.restart()
            self._side = side
            self._begin(t_ns, integral_N)
        self._t_ns = t_ns
        self._count += 1
        self._depths_m += depth_m
        self._errors_m += error_m
        if self.direction and abs(depth_m - self._place_m) > self._reach_m:
            self.direction = 0.0
            self._past.clear()
        if t_ns - self._since_ns < self._interval_ns:
            return
        self._past.append((self._depths_m / self._count, self._first_N))
        depths = [mean_m for mean_m, _ in self._past]
        still_m = min(MAX_SHARE * abs(self._errors_m) / self._count, MAX_MOTION_M)
        self.direction = side if len(depths) == INTERVALS and max(depths) - min(depths) < still_m else 0.0
        self._place_m, self._reach_m = depths[-1], max(2.0 * still_m, MIN_RELEASE_M)
        if self.direction:
            self.integral_N = integral_N = self._past[0][1]
            self._past.extend([(mean_m, integral_N) for mean_m in depths])
        self._begin(t_ns, integral_N)

    def _begin(self, t_ns: int, integral_N: float) -> None:
        """Begin an interval."""
        self._since_ns, self._first_N, self._count = t_ns, integral_N, 0
        self._depths_m = self._errors_m = 0.0
