"""The horizon that fits a vehicle: what `vehicle check` proposes, and what `controller` takes where none is given."""

from __future__ import annotations

import math

from ltv_mpc.control.config import STAGE_NS
from ltv_mpc.control.scales import scales_of
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.performance import Performance, performance

SHORTEST_S, LONGEST_S = 3.0, 60.0

ENOUGH = 1.9
"""Of the time scale T: so long a horizon is enough at nine of ten places of the map in docs/horizon.md, where the error
is then within 10 % of that with the best."""

WEAK_ASTERN = 0.7
"""Top speed astern over that ahead."""


def proposed_horizon_s(vehicle: Vehicle) -> float:
    """Of a vehicle of which nothing else is known."""
    return horizon_of(performance(vehicle), scales_of(vehicle).time_s)


def horizon_of(can: Performance, time_s: float) -> float:
    """1.9 of the time scale ``time_s``, and at least the time to turn and to stop, in whole stages (s).

    A plan that sees both can come to a point and stay there. The turn is one by 90 deg, and by 180 deg where the
    vehicle goes astern much slower than ahead: else a plan holds the stern into a current that only the bow can bear.
    """
    both = 0.0
    if can.turn_90deg_s is not None:
        both = can.turn_90deg_s + (can.stopping_time_s or 0.0)
        if _weak_astern(can):
            both += 0.5 * math.pi / _slower_rate(can)
    enough = max(ENOUGH * time_s, both)
    stage = STAGE_NS * 1e-9
    return round(math.ceil(min(max(enough, SHORTEST_S), LONGEST_S) / stage - 1e-9) * stage, 1)


def _weak_astern(can: Performance) -> bool:
    ahead, astern = can.top_speed_ahead_mps, can.top_speed_astern_mps
    return ahead is not None and astern is not None and astern < WEAK_ASTERN * ahead


def _slower_rate(can: Performance) -> float:
    """Turning rate (rad/s) to the slower side."""
    rates = (can.turning_rate_starboard_radps, can.turning_rate_port_radps)
    return min(abs(rate) for rate in rates if rate)
