"""Interface of the simulated sensors, the outliers of those that have them, and their drifting biases.

A bias is a first-order Gauss-Markov process in time:

b(0) ~ N(0, sd^2),  b(t + dt) = exp(-dt / tau) b(t) + sd sqrt(1 - exp(-2 dt / tau)) N(0, 1):  sd at every time
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import Array, Message
from sim.sensors.vehicle_state import Motion, VehicleState
from sim.water import WaterColumn


class Environment(NamedTuple):
    """Water, sea bed and seed of the run, from which the simulated sensors are made."""

    sensor_config: SensorConfig  # settings of all sensors of the vehicle
    seed: int  # of the run; each sensor draws from a stream of its own
    water: WaterColumn
    bottom_m: float | None  # depth of the sea bed; None: out of reach


class SimulatedSensor(Protocol):
    """Sensor that measures at an instant."""

    def sample(self, now: VehicleState) -> Sequence[Message]:
        """Return the messages whose validity time is now, if any."""
        ...


@runtime_checkable
class InterrogatingSensor(Protocol):
    """Sensor that sends an interrogation when it samples, and receives the replies later."""

    def sample(self, now: VehicleState) -> Sequence[Message]:
        """Send the interrogation and return an empty sequence: nothing is measured yet."""
        ...

    def answers(self, motion: Motion, until_ns: int) -> Sequence[Any]:
        """Return the messages that arrive during ``motion``, which ends at ``until_ns``.

        It must be called for every interval of the motion, in order: replies that are under way wait for the next one.
        """
        ...

    def arrival_ns(self, message: Any) -> int:
        """Return the time (ns) at which a message of ``answers`` arrives."""
        ...


def outliers(uniform: Array, share: float) -> Array:
    """Return 1 or -1 at a share of the places, each sign at half of it, and 0 at the others; ``uniform`` decides."""
    return (uniform < 0.5 * share).astype(np.float64) - (uniform > 1.0 - 0.5 * share)


class GaussMarkovBias:
    """Independent biases, each with its standard deviation and time constant."""

    def __init__(self, sd: float | Array, tau_s: float | Array, size: int, draws: np.random.Generator) -> None:
        """Draw the first values. ``sd`` and ``tau_s`` hold one number for all biases, or one for each."""
        self._draws, self._sd, self._tau_s = draws, np.broadcast_to(sd, size), np.broadcast_to(tau_s, size)
        self._coefficients: dict[float, tuple[Array, Array]] = {}  # by dt_s: decay, and sd of the new part
        self.value: Array = self._sd * draws.standard_normal(size)

    def advance(self, dt_s: float) -> Array:
        """Move the biases on by dt_s and return them, (size,)."""
        if dt_s not in self._coefficients:
            new_sd = self._sd * np.sqrt(-np.expm1(-2.0 * dt_s / self._tau_s))
            self._coefficients[dt_s] = np.exp(-dt_s / self._tau_s), new_sd
        decay, new_sd = self._coefficients[dt_s]
        self.value = decay * self.value + new_sd * self._draws.standard_normal(len(self.value))
        return self.value
