"""True states written down by hand, and what the errors of a simulated sensor must be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from ltv_mpc import frames
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import Message, Truth
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.validation import rejection_reason
from ltv_mpc.vehicle.parameters import Vehicle
from sim.plant import Plant
from sim.scenario import Scenario, with_overrides
from sim.sensors.node import Sensors
from sim.sensors.vehicle_state import VehicleState
from sim.water import make
from tests.stepping import unpacked

MS, S = 1_000_000, 1_000_000_000
S20, C20 = math.sin(math.radians(20)), math.cos(math.radians(20))
AXES = np.array([[S20, 0, C20], [-S20, 0, C20], [0, S20, C20], [0, -S20, C20]])
"""Directions of a profiler's four beams, in its own axes."""
STILL = (0.0, 0.0, 0.0)


def truth(t_ns: int = 0, **changes: Any) -> Truth:
    """Return the truth of a vehicle at rest at the origin in still water, with changes."""
    at_rest = {"position_m": STILL, "velocity_mps": STILL, "attitude_rad": STILL, "water_velocity_mps": STILL}
    at_rest |= {"yaw_rate_radps": 0.0, "current_mps": (0.0, 0.0), "thrust_N": STILL}
    return Truth(t_ns=t_ns, **(at_rest | changes))


def instant(t_ns=0, *, attitude=STILL, position=(1.0, 2.0, 5.0), velocity=STILL, rate=STILL) -> VehicleState:
    return VehicleState(t_ns, position, velocity, frames.rotation(*attitude), lambda: np.array(rate), 0.0)


def plant_of(*settings: str, vehicle: str = "paper") -> Plant:
    """Return the plant of a vehicle in the paper's descent, with assignments as of ``--set``."""
    scenario = with_overrides(Scenario.load("descent"), list(settings))
    return Plant(scenario, Vehicle.load(vehicle), make(scenario.water, scenario.run.seed))


def sensed(suite: SensorConfig, world: Sequence[Truth], scenario: Scenario) -> list[tuple[int, Message]]:
    """Return each message of the sensors with the time of its publication, in order."""
    node = Sensors(scenario, suite, make(scenario.water, scenario.run.seed))
    out = []
    for k, now in enumerate(world):
        for message in node.step(now.t_ns, [ReceivedMessage(now, 1, k, now.t_ns)]):
            assert type(message) in node.writes
            assert rejection_reason(message) is None
            out += [(now.t_ns, part) for part in unpacked([message])]
    return out


def check_white(errors, sd: float) -> None:
    """Check errors in rows over time: mean zero, the given size, and no correlation in time or between columns."""
    z = np.asarray(errors) / sd
    assert abs(z.mean()) < 4.5 / math.sqrt(z.size)
    assert (z**2).mean() == pytest.approx(1.0, abs=4.5 * math.sqrt(2 / z.size))
    for axis in range(z.ndim):
        product = np.delete(z, 0, axis) * np.delete(z, -1, axis)
        if product.size:
            assert abs(product.mean()) < 4.5 / math.sqrt(product.size)


def check_share(found, share: float) -> None:
    found = np.asarray(found)
    assert found.mean() == pytest.approx(share, abs=4.5 * math.sqrt(share / found.size))
