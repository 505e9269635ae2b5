"""Moving obstacles: reports by id, predicted at constant velocity with growing uncertainty, and dropped when old.

Their times are on the clock of the estimates. A report from the future, as one with UTC beside a vehicle whose time
begins at 0, would be extrapolated back and would stay the newest one for ever: it is not used.

    p(t) = p + (t - t0) v,     radius(t) = radius + k sd(t),     sd(t)^2 = P + (q (t - t0))^2

with the time t0 of the report, the largest variance P of its position in any direction, k = ``SD_FACTOR`` and
q = ``GROWTH_MPS``.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, Obstacle, Obstacles, Pair
from ltv_mpc.validation import rejection_reason

SD_FACTOR = 3.0
"""k: standard deviations of a position that a required clearance covers; also of the vehicle's, beside a zone."""

OBSTACLE_MARGIN = 1.0
"""Distance that is kept between the hull and an obstacle, in radii of the hull."""

GROWTH_MPS = 0.05
"""Growth q of the standard deviation of a predicted position (m/s)."""

MAX_AGE_NS = 60_000_000_000
"""Age at which an obstacle is dropped: six reports of a source that reports every 10 s are missing."""

MAX_AHEAD_NS = 2_000_000_000
"""Largest time by which a report is ahead of the vehicle's clock: clocks that are synchronised differ by less."""

MAX_OBSTACLES = 64
"""Largest number of obstacles; of more, those with the oldest reports are dropped."""

STANDING_AGE_S = 10.0
"""Least age of a report for the distance that the reference keeps: with the true one it would change in every cycle."""

MAX_NEW = 16 * MAX_OBSTACLES
"""Largest number of reports between two cycles; of more, those that came last are kept."""

DISC = 7
"""Numbers of an obstacle for compiled code."""


class ObstacleTable:
    """Newest report of every obstacle."""

    def __init__(self) -> None:
        """Begin without obstacles."""
        self._by_id: dict[int, Obstacle] = {}
        self._new: deque[Obstacle] = deque(maxlen=MAX_NEW)  # times not checked yet; last one first

    def __len__(self) -> int:
        """Return the number of obstacles."""
        return len(self._by_id)

    @property
    def reports(self) -> tuple[Obstacle, ...]:
        """Newest report of every obstacle."""
        return tuple(self._by_id.values())

    def add(self, obstacles: Obstacles) -> None:
        """Take reports, which count from the next ``update`` on.

        Parameters
        ----------
        obstacles : some or all obstacles.

        Raises
        ------
        ConfigError : a value is out of its bounds; then none of the reports is taken.
        """
        reason = rejection_reason(obstacles)
        if reason is not None:
            raise ConfigError("obstacles", "", reason)
        self._new.extendleft(obstacles.obstacles)

    def update(self, t_ns: int) -> tuple[int, ...]:
        """Keep the newest report of every obstacle that is neither too old nor ahead of the vehicle's time.

        Parameters
        ----------
        t_ns : now, vehicle time (ns).

        Returns
        -------
        Identifiers of the obstacles of which a report is dropped because of its time.
        """
        reports = [*self._new, *self._by_id.values()]  # of two with the same time, the later one counts
        self._new.clear()
        self._by_id, dropped = {}, set()
        for report in sorted(reports, key=lambda report: -report.t_ns):
            if not -MAX_AHEAD_NS <= t_ns - report.t_ns <= MAX_AGE_NS:
                dropped.add(report.id)
            elif len(self._by_id) < MAX_OBSTACLES:
                self._by_id.setdefault(report.id, report)
        return tuple(sorted(dropped))

    def discs(self, t_ns: int) -> Array:
        """Return the obstacles for compiled code (O, ``DISC``).

        Parameters
        ----------
        t_ns : time of the first knot (ns).

        Returns
        -------
        Of each: north, east (m) at that time, velocity (m/s), radius (m), P (m2), age (s).
        """
        rows = np.empty((len(self._by_id), DISC))
        for row, report in zip(rows, self._by_id.values(), strict=True):
            velocity = report.velocity_north_mps, report.velocity_east_mps
            variance_m2, age_s = largest_variance_m2(*report.covariance_m2), (t_ns - report.t_ns) * 1e-9
            row[:] = *predicted_m(report, t_ns), *velocity, report.radius_m, variance_m2, max(age_s, 0.0)
        return rows

    def standing(self, t_ns: int, max_speed_mps: float, need_m: float) -> Array:
        """Return where the obstacles that hardly move are, in the order of their ids (S, 3).

        Parameters
        ----------
        t_ns : time of the first knot (ns).
        max_speed_mps : speed up to which an obstacle counts (m/s).
        need_m : distance that is kept between the vehicle's origin and an obstacle (m).

        Returns
        -------
        Of each: north, east and required clearance (m), with the uncertainty at the age ``STANDING_AGE_S`` at least.
        """
        rows = []
        for report in sorted(self._by_id.values(), key=lambda report: report.id):
            if math.hypot(report.velocity_north_mps, report.velocity_east_mps) <= max_speed_mps:
                age_s = max((t_ns - report.t_ns) * 1e-9, STANDING_AGE_S)
                rows.append((*predicted_m(report, t_ns), required_m(report, age_s, need_m)))
        return np.array(rows).reshape(-1, 3)


def predicted_m(report: Obstacle, t_ns: int) -> Pair:
    """Return where an obstacle is at a time, if it keeps its velocity: north and east (m).

    Parameters
    ----------
    report : position and velocity at its time.
    t_ns : vehicle time (ns).
    """
    age_s = (t_ns - report.t_ns) * 1e-9
    return report.north_m + age_s * report.velocity_north_mps, report.east_m + age_s * report.velocity_east_mps


def required_m(report: Obstacle, age_s: float, need_m: float) -> float:
    """Return how far from an obstacle the vehicle's origin stays (m): ``disc_at`` of ocp/fence.py, not compiled.

    Parameters
    ----------
    report : radius and uncertainty at its time.
    age_s : age of the report at the time in question (s).
    need_m : distance between the vehicle's origin and an obstacle that is known exactly (m).
    """
    sd_m = math.hypot(math.sqrt(largest_variance_m2(*report.covariance_m2)), GROWTH_MPS * age_s)
    return report.radius_m + SD_FACTOR * sd_m + need_m


def largest_variance_m2(nn: float, ne: float, ee: float) -> float:
    """Return the largest variance in any direction (m2): the larger eigenvalue of the covariance [[nn, ne], [ne, ee]].

    Parameters
    ----------
    nn, ne, ee : covariance of north and east (m2).
    """
    return max(0.5 * (nn + ee) + math.sqrt(0.25 * (nn - ee) ** 2 + ne * ne), 0.0)
