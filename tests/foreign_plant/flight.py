"""The foreign craft and the controller at simulated time, in a current of 0.2 m/s that the controller does not know.

Every message passes as bytes through the codec, the message validation and the clock synchronisation of a process. A
scenario changes ``sources``, or sets the clock of the craft.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import msgpack
import numpy as np
import shapely

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import ClockStep, Message, Plan
from ltv_mpc.node import DEFAULT_SOURCE, ReceivedMessage
from ltv_mpc.references import Point
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Frame
from services.bus.message_validation import MessageValidator
from services.bus.rate_limit import RateLimit
from services.bus.time_shift import shifted
from services.bus.topics import source_of, topic_at
from services.bus.wire import Header, WireError, encode
from services.runtime.clock import VehicleClock
from services.runtime.clock_offset import ClockOffset
from services.runtime.clock_sync import ClockSync
from tests.foreign_plant.plant import STEP_NS, Actuators, Hull, Sender

HERE = Path(__file__).parent
HULL, SQUARE = HERE / "hull.toml", HERE / "square.toml"
ORIGIN = Point(north_m=0.0, east_m=0.0)
CURRENT_MPS = (0.12, -0.16)
BEGUN_NS = 1_790_000_000_123_456_789
"""Start of its clock, which counts from 1970."""
STEP_US = STEP_NS // 1000
ESTIMATE_PERIOD_US, CYCLE_PERIOD_US = 100_000, 300_000
DELAY_US = 60_000
"""Default time from the start of a cycle to the plan's arrival."""
EPOCH = 1
"""Of the controller."""


Source: TypeAlias = tuple[str, Sender, Callable[[int], dict[str, Any]]]
"""Key, sender, and the fields of its message by the time of the craft (ns)."""

CORNERS = np.array([[0.0, 0.0], [0.0, 20.0], [-20.0, 20.0], [-20.0, 0.0]])
SIDE_M, SPEED_MPS = 20.0, 1.0
"""Of the square."""


class Flight:
    """Foreign craft and controller at simulated time."""

    def __init__(
        self,
        *,
        config: ControllerConfig | None = None,
        reports: bool = True,
        heading_rad: float = 2.2,
        delay_us: int = DELAY_US,
        start_m: tuple[float, float] = (0.0, 0.0),
        armed: bool = False,
    ) -> None:
        """Begin at ``start_m``. Without ``reports`` the actuators publish nothing."""
        self.hull = Hull(heading_rad=heading_rad, current_mps=CURRENT_MPS)
        self.hull.x[:2] = start_m
        self.actuators, self.sender = Actuators(), Sender()
        self.sources: list[Source] = [("estimate", self.sender, self.hull.estimate)]
        """Of the estimates, which are published every 0.1 s."""
        self.node = ControllerNode(Vehicle.load(str(HULL)), ORIGIN, config or ControllerConfig())
        self.validator = MessageValidator(RateLimit())
        self.plans: list[Plan] = []
        """Plans in the controller's time."""
        self.clock_steps: list[ClockStep] = []
        self.outputs: list[Message] = []
        """All other messages of the controller."""
        self.host_us = 0
        """Monotonic time of the host."""
        self._track: list[tuple[float, float]] = []
        self._ahead_ns = BEGUN_NS
        self._delay_us = delay_us
        self._reports = reports
        self._clock = VehicleClock()
        self._sync = ClockSync(self._clock, epoch=EPOCH)
        self._runs = True
        self._inbox: list[ReceivedMessage] = []
        self._under_way: list[tuple[int, bytes]] = []
        self._sequence = 0
        if armed:
            self.command(action="arm")

    # --- what a scenario does ---

    def kill_controller(self) -> None:
        """Kill the process of the controller; its plans that are under way still arrive."""
        self._runs, self._inbox = False, []

    def set_clock(self, step_s: float) -> None:
        """Set the clock of the craft."""
        self._ahead_ns += round(step_s * 1e9)

    def command(self, **fields: str) -> None:
        """Send a command as an operator."""
        self._receive("command", self.sender, {"command_id": self.host_us, **fields})

    def fly(self, seconds: float) -> np.ndarray:
        """Fly for a time. Return its positions (M, 2), north and east (m), one each 20 ms."""
        begin = len(self._track)
        for _ in range(round(seconds * 1e6) // STEP_US):
            self._step()
        return np.array(self._track[begin:])

    def follow_square(self) -> None:
        """Send the square as an operator."""
        self.command(action="follow", reference_toml=SQUARE.read_text())

    @property
    def track(self) -> np.ndarray:
        """Positions (M, 2) since the start, north and east (m), one each 20 ms."""
        return np.array(self._track)

    @property
    def craft_ns(self) -> int:
        """Time by the clock of the craft."""
        return self._ahead_ns + self.host_us * 1000

    @property
    def clock_offset(self) -> ClockOffset:
        """Offset to the clock of the craft, as the controller knows it."""
        return self._sync.offset(self.host_us)

    # --- one step ---

    def _step(self) -> None:
        while self._under_way and self._under_way[0][0] <= self.host_us:
            self.actuators.offer(msgpack.unpackb(self._under_way.pop(0)[1]), self.craft_ns)
            self._report()
        if self.host_us % ESTIMATE_PERIOD_US == 0:
            for key, sender, fields in self.sources:
                self._receive(key, sender, fields(self.craft_ns))
            self._report()
        if self._runs and self.host_us % CYCLE_PERIOD_US == 0 and self._sync.active:
            self._cycle()
        self.hull.step(self.actuators.step(self.craft_ns))
        self._track.append((self.hull.x[0], self.hull.x[1]))
        self.host_us += STEP_US

    def _report(self) -> None:
        if self._reports:
            self._receive("applied", self.sender, self.actuators.report(self.craft_ns, self.hull.thrust_N))

    def _receive(self, key: str, sender: Sender, fields: dict[str, Any]) -> None:
        """Pass a message to the controller, if it runs, as its process does."""
        if not self._runs:
            return
        frame = Frame(topic_at(key), key, sender.pack(key, fields), self.host_us)
        try:
            message, header = self.validator.validate(frame)
        except WireError:
            return  # counted by the validator
        rejected = self._sync.check_stamp(message, header.epoch, self.host_us)
        for clock_step in self._sync.take_steps():
            self.clock_steps.append(clock_step)
            self._put(clock_step, 0, 0)
        if not rejected:
            shift_ns = self._sync.shift_ns(header.epoch, self.host_us)
            self._put(shifted(message, shift_ns), header.epoch, header.sequence, source_of(key))

    def _put(self, message: Message, epoch: int, sequence: int, source: str = DEFAULT_SOURCE) -> None:
        received_ns = self._clock.read(self.host_us)
        # A command may come before the first stamp that tells the time.
        self._inbox.append(ReceivedMessage(message, epoch, sequence, received_ns or 0, source))

    def _cycle(self) -> None:
        t_ns = self._clock.read(self.host_us)
        assert t_ns is not None
        inbox, self._inbox = self._inbox, []
        outputs = self.node.step(t_ns, inbox)
        if self.node.active_source is not None:
            self._sync.follow_source(self.node.active_source.epoch, self.host_us)
        for message in outputs:
            if isinstance(message, Plan):
                self.plans.append(message)
                payload = encode(
                    shifted(message, self._sync.published_shift_ns), Header(epoch=EPOCH, sequence=self._sequence)
                )
                self._sync.on_plan_sent(self._sequence, self.host_us)
                self._sequence += 1
                self._under_way.append((self.host_us + self._delay_us, payload))
            else:
                self.outputs.append(message)


def farthest_m(track: np.ndarray) -> float:
    """Return the largest distance of positions (M, 2) from the origin (m)."""
    return float(np.hypot(*track.T).max())


def distance_from_outline_m(track: np.ndarray) -> np.ndarray:
    """Return the distance (M,) of positions (M, 2) from the outline of the square (m)."""
    distance: np.ndarray = shapely.distance(shapely.LinearRing(CORNERS), shapely.points(track))
    return distance
