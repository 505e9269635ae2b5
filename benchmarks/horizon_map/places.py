"""Places of the horizon map: one current, descent, vehicle and delay, flown in the same waters with several horizons.

What is enough there is the shortest horizon whose mean error is within 10 % of the best one's. Places are compared in
the vehicle's own speed V and time T (``ltv_mpc/control/scaling.py``), by four groups without a dimension:

    strength    sd / V              how strong the current is
    layer       l / (w T)           how long the vehicle takes to sink through one correlation length
    change      q sqrt(T) / V       how much the current changes while the vehicle turns, q in m/s per sqrt(s)
    delay       D / T
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.messages import Array
from services.tools.campaign.campaign import reopen_campaign
from services.tools.campaign.trial import run_config

HORIZON = "controller.horizon_s"
FIGURE = "true_error_m.mean"
ENOUGH = 1.1
GROUPS = ("strength", "layer", "change", "delay")


class Place(NamedTuple):
    """One place of the design, all horizons."""

    time_s: float  # T of its vehicle
    groups: Array  # (4,), as GROUPS
    horizons_s: Array  # (H,)
    errors_m: Array  # (H,) mean over seeds

    @property
    def enough(self) -> int:
        """Index of the shortest horizon whose error is small enough."""
        return int(np.argmax(self.errors_m <= ENOUGH * self.errors_m.min()))

    def excess(self, horizon_s: float) -> float:
        """Return the relative excess of the error at the nearest horizon over that of the best one; 0.1 is 10 %."""
        i = int(np.argmin(np.abs(np.log(self.horizons_s / horizon_s))))
        return float(self.errors_m[i] / self.errors_m.min() - 1.0)


def places(folder: Path) -> list[Place]:
    """Return the places of a campaign's folder for which every horizon and seed exists."""
    made, rows = reopen_campaign(folder)
    campaign, base = made.campaign, made.base
    errors: dict[int, list[float]] = {}
    for row in rows:
        if row[FIGURE] is not None:
            errors.setdefault(row["point"], []).append(row[FIGURE])
    horizons = np.array(campaign.cross[HORIZON], dtype=np.float64)
    found = []
    for first in range(0, len(made.points), len(horizons)):
        of = [errors.get(first + k, []) for k in range(len(horizons))]
        if any(len(runs) < campaign.seeds.count for runs in of):
            continue
        point = made.points[first]
        here = run_config(base, made.settings(point), made.factors(point), campaign.seeds.first)
        scales = characteristic_scales(here.vehicle)
        water, V, T = here.scenario.water, scales.speed_mps, scales.time_s
        rate = here.reference.descent_rate_mps
        groups = np.array(
            [
                water.sd_mps / V,
                water.correlation_length_m / (rate * T),
                water.change_mps_per_rts * math.sqrt(T) / V,
                here.scenario.run.compute_delay_s / T,
            ]
        )
        found.append(Place(T, groups, horizons, np.array([np.mean(runs) for runs in of])))
    return found


def in_own_time(of: Sequence[Place]) -> Array:
    """Return the sufficient horizon at each place, divided by T."""
    return np.array([place.horizons_s[place.enough] / place.time_s for place in of])


def relative(of: Sequence[Place]) -> Array:
    """Return the errors over that of the best horizon at the same place, (K, H)."""
    return np.array([place.errors_m / place.errors_m.min() for place in of])


def thirds(of: Sequence[Place], group: str) -> list[Array]:
    """Return the places in the lowest, middle and highest third of a group."""
    column = [place.groups[GROUPS.index(group)] for place in of]
    return np.array_split(np.argsort(column, kind="stable"), 3)
