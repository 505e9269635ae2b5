"""The foreign craft behind the simulated autopilot and the edge to MAVLink, at simulated time.

Each frame passes as bytes over a link that may lose, delay and repeat it, in both directions.
"""

from __future__ import annotations

import importlib.util
import random
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ltv_mpc.messages import Acknowledgement, Applied, Authority, Estimate, Plan
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.time_shift import shifted
from services.bus.wire import decode
from services.edges.edge import Outgoing, Received
from services.edges.mavlink.codec import Codec
from services.edges.mavlink.edge import MavlinkEdge, Settings
from tests.foreign_plant.flight import HULL, STEP_US, Flight
from tests.foreign_plant.plant import Hull

ROOT = Path(__file__).resolve().parents[2]
GCS, EDGE_LINK, GCS_LINK = 255, 0, 1
STEP_PERIOD_US, BEAT_US = 40_000, 1_000_000
REORDER_US = 60_000


def example() -> ModuleType:
    """Return the module of the simulated autopilot."""
    spec = importlib.util.spec_from_file_location("autopilot", ROOT / "examples/python/simulated_autopilot.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


EXAMPLE = example()


class Craft:
    """Foreign hull as the simulated autopilot sees it; its drivers take the thrust that the table gives for a PWM."""

    def __init__(self, hull: Hull) -> None:
        self.hull = hull

    def step(self, command_N: tuple[float, float]) -> None:
        self.hull.step(command_N)

    def position(self) -> tuple[float, float, float]:
        north, east, down = self.hull.x[:3].tolist()
        return north, east, down

    def velocity(self) -> tuple[float, float, float]:
        fields = self.hull.estimate(0)
        return fields["velocity_north_mps"], fields["velocity_east_mps"], 0.0

    def attitude(self) -> tuple[float, ...]:
        heading_rad = self.hull.estimate(0)["heading_rad"]
        return *self.hull.plant.attitude_rad, heading_rad, *self.hull.x[10:13].tolist()


def vehicle() -> Vehicle:
    """Return the data sheet of the hull with the table of PWM of the simulated autopilot."""
    of = Vehicle.load(str(HULL))
    table = {"pwm_us": EXAMPLE.PWM_US, "pwm_N": EXAMPLE.PWM_N}
    sides = {side: msgspec.structs.replace(getattr(of.thruster, side), **table) for side in ("port", "starboard")}
    return msgspec.structs.replace(of, thruster=msgspec.structs.replace(of.thruster, **sides))


class Faults(NamedTuple):
    """Share of the frames that are lost, delayed behind later ones, and repeated."""

    lost: float = 0.0
    reordered: float = 0.0
    repeated: float = 0.0


BAD = Faults(lost=0.2, reordered=0.2, repeated=0.2)


class MavlinkFlight(Flight):
    """Flight whose estimates and thrusts pass through the edge and the autopilot."""

    def __init__(
        self, *, faults: Faults | None = None, key: bytes | None = None, v1: bool = False, **named: Any
    ) -> None:
        super().__init__(reports=False, **named)
        self.autopilot = EXAMPLE.Autopilot(Craft(self.hull), gcs_sysid=GCS, key=key, v1=v1)
        self.edge = MavlinkEdge(1, Settings(vehicle=vehicle(), ground_station=GCS), Codec(GCS, key, stamp=10**13))
        self.station: Any = dialect.MAVLink(None, srcSystem=GCS, srcComponent=190)
        if key is not None:
            self.station.signing.secret_key, self.station.signing.sign_outgoing = key, True
            self.station.signing.timestamp = self.autopilot.mav.signing.timestamp = 10**13
        self.station_beats = True
        self.rejection = ""
        """Reason with which the controller rejects each command of the edge; empty: it accepts them."""
        self.relays = False
        """The edge's commands go to the controller, which replies."""
        self.frames = {"to edge": 0, "to autopilot": 0}
        self._faults = faults or Faults()
        self._rng = random.Random(1)
        self._air: list[tuple[int, int, str, bytes]] = []  # arrival, order, way, datagram
        self._order = 0

    def arm(self, *, mode: int = 0) -> None:
        """Let the ground station arm the autopilot and set its mode."""
        self.beat()
        for command, first, second in ((176, 1.0, float(mode)), (400, 1.0, 0.0)):
            self.from_station(self.station.command_long_encode(1, 1, command, 0, first, second, 0, 0, 0, 0, 0))

    def beat(self) -> None:
        """Send a heartbeat of the ground station."""
        self.from_station(self.station.heartbeat_encode(6, 8, 0, 0, 4))

    def from_station(self, message: Any) -> None:
        """Pass a message of the ground station to the autopilot."""
        self.deliver(self.autopilot.receive(bytes(message.pack(self.station)), GCS_LINK))

    def send(self, way: str, data: bytes) -> None:
        """Put a datagram on the link between autopilot and edge."""
        rng, faults = self._rng, self._faults
        self.frames[way] += 1
        for _ in range(2 if rng.random() < faults.repeated else 1):
            if rng.random() >= faults.lost:
                late_us = REORDER_US if rng.random() < faults.reordered else 0
                self._order += 1
                self._air.append((self.host_us + late_us, self._order, way, data))

    def deliver(self, datagrams: Any) -> None:
        """Put what the autopilot sends onto the link to the edge."""
        for to, data in datagrams:
            if to == EDGE_LINK or (to < 0 and to != -1 - EDGE_LINK):
                self.send("to edge", data)

    def pass_on(self, outputs: Any) -> None:
        """Pass what the edge returns to its receivers."""
        for output in outputs:
            if isinstance(output, Outgoing):
                self.send("to autopilot", output.payload)
            elif isinstance(output, Estimate):
                fields = {name: getattr(output, name) for name in self.hull.estimate(0)}
                assert output.covariance is not None
                fields["covariance"] = output.covariance.tolist()  # by it the controller weighs the change of velocity
                self._receive("estimate", self.sender, fields)
            elif isinstance(output, Applied):
                self._receive("applied", self.sender, msgspec.structs.asdict(output))
            elif self.relays:
                self.outputs.append(output)
                self._receive("command", self.sender, msgspec.structs.asdict(output))
            else:
                self.outputs.append(output)
                answer = Acknowledgement(
                    t_ns=0,
                    command_id=output.command_id,
                    accepted=not self.rejection,
                    authority=Authority.DISARMED,
                    why=self.rejection,
                )
                self.pass_on(self.edge.take(answer, self.host_us))

    def _step(self) -> None:
        while self._under_way and self._under_way[0][0] <= self.host_us:
            plan, header = decode(Plan, self._under_way.pop(0)[1])
            self.pass_on(self.edge.take(plan, self.host_us, (header.epoch, header.sequence)))
        if self.host_us % STEP_PERIOD_US == 0:
            self.pass_on(self.edge.step(self.host_us))
        if self.station_beats and self.host_us % BEAT_US == 0:
            self.beat()
        self.deliver(self.autopilot.step())
        now = sorted(one for one in self._air if one[0] <= self.host_us)
        self._air = [one for one in self._air if one[0] > self.host_us]
        for _, _, way, data in now:
            if way == "to edge":
                self.pass_on(self.edge.receive(Received("", data, b"", self.host_us)))
            else:
                self.deliver(self.autopilot.receive(data, EDGE_LINK))
        if self._runs and self.host_us % 300_000 == 0 and self._sync.active:
            known = len(self.outputs)
            self._cycle()
            for message in [one for one in self.outputs[known:] if isinstance(one, Acknowledgement)]:
                reply = shifted(message, self._sync.published_shift_ns)
                self.pass_on(self.edge.take(reply, self.host_us))
        self._track.append((self.hull.x[0], self.hull.x[1]))
        self.host_us += STEP_US
