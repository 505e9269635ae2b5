"""The horizon that fits a vehicle: what `vehicle check` proposes, and what `controller` takes where none is given."""

from __future__ import annotations

import math

from ltv_mpc.control.config import STAGE_NS
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.control.stability import is_stable
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.performance import Performance, performance

MIN_HORIZON_S, MAX_HORIZON_S = 3.0, 60.0

MIN_TIME_SCALES = 1.9
"""Of the time scale T: so long a horizon is enough at nine of ten places of the map in docs/horizon.md, where the error
is then within 10 % of that with the best."""

LENGTHENING = 1.05
"""Steps in which a horizon is lengthened until its loop is stable."""

WEAK_ASTERN_RATIO = 0.7
"""Top speed astern over that ahead."""


def proposed_horizon_s(vehicle: Vehicle) -> float:
    """Of a vehicle of which nothing else is known."""
    return select_horizon_s(vehicle, performance(vehicle))


def select_horizon_s(vehicle: Vehicle, can: Performance) -> float:
    """1.9 T, at least the time to turn and to stop, and what the loop needs to be stable, in whole stages (s).

    A plan that sees both can come to a point and stay there. The turn is one by 90 deg, and by 180 deg where the
    vehicle goes astern much slower than ahead: what it will do stern-to is foreseen the sooner. A vehicle that is
    light to the side needs longer than that, or it goes to and fro about its place (``stability.py``).
    """
    both = 0.0
    if can.turn_90deg_s is not None:
        both = can.turn_90deg_s + (can.stopping_time_s or 0.0)
        if _weak_astern(can):
            both += 0.5 * math.pi / _slower_rate(can)
    horizon_s = _whole(max(MIN_TIME_SCALES * characteristic_scales(vehicle).time_s, both))
    while horizon_s < MAX_HORIZON_S and not is_stable(vehicle, horizon_s):
        horizon_s = _whole(LENGTHENING * horizon_s)
    return horizon_s


def _whole(horizon_s: float) -> float:
    """In whole stages, within bounds."""
    stage = STAGE_NS * 1e-9
    return round(math.ceil(min(max(horizon_s, MIN_HORIZON_S), MAX_HORIZON_S) / stage - 1e-9) * stage, 1)


def _weak_astern(can: Performance) -> bool:
    ahead, astern = can.top_speed_ahead_mps, can.top_speed_astern_mps
    return ahead is not None and astern is not None and astern < WEAK_ASTERN_RATIO * ahead


def _slower_rate(can: Performance) -> float:
    """Turning rate (rad/s) to the slower side."""
    rates = (can.turning_rate_starboard_radps, can.turning_rate_port_radps)
    return min(abs(rate) for rate in rates if rate)
