"""Detector of a vehicle that does not move in depth although the depth law pushes it: afloat, aground or held.

At rest, an error of the modelled buoyancy and the force of the surface, the bottom or a line look alike. They differ in
what the integral of the law achieves: it moves the vehicle against a wrong buoyancy, and never against a stop. Let z1,
z2, z3 be the mean depths of successive intervals of length T, and e the mean depth error of the last one:

    blocked   if z1, z2, z3 are within min(|e| / 4, 0.1 m), and the law pushed to one side all the time
    free      if the law pushes to the other side, or the depth leaves z3 by twice that
    T         1.5 (2 zeta / w0 + d_z / (M_z w0^2)), the time in which the law closes an error: 10 s without damping d_z

Two intervals would not do: an error that passes through its maximum has the same mean before and after. The means
remove the noise of the depth and the waves.
"""

from __future__ import annotations

import math
from collections import deque

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
