"""Interface of the simulated sensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import Message
from sim.sensors.vehicle_state import Motion, VehicleState
from sim.water import WaterColumn


class Environment(NamedTuple):
    """Quantities that a sensor is made from, in addition to its settings."""

    sensors: SensorConfig  # settings of all sensors of the vehicle
    seed: int  # of the run; each sensor draws from a stream of its own
    water: WaterColumn
    bottom_m: float | None  # depth of the sea bed; None: out of reach


class SimulatedSensor(Protocol):
    """A sensor that measures at an instant."""

    def sample(self, now: VehicleState) -> Sequence[Message]:
        """Return the messages whose validity time is now, if any."""
        ...


@runtime_checkable
class InterrogatingSensor(Protocol):
    """A sensor that sends a signal when it samples, and receives answers at other times."""

    def sample(self, now: VehicleState) -> Sequence[Message]:
        """Send the signal; nothing is measured yet."""
        ...

    def answers(self, motion: Motion, until_ns: int) -> Sequence[Any]:
        """Return the messages that arrive by ``until_ns``, the end of ``motion``. Call it for every motion in turn."""
        ...

    def arrival_ns(self, message: Any) -> int:
        """Return the time (ns) at which one of the answers arrives."""
        ...
