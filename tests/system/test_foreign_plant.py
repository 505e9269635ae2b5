"""A plant written from docs/protocol.md alone, in a current of 0.2 m/s that the controller does not know."""

from __future__ import annotations

import ast
import json
import math
import sys
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

from ltv_mpc.control.config import ControllerConfig, Disturbance
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Point, Reference
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Frame
from services.bus.message_validation import MessageValidator
from services.bus.topics import BY_KEY, key_of
from services.bus.wire import Header, encode
from services.supervisor import loopback
from tests.stepping import step
from tests.system.alone import controller, started
from tests.system.foreign_plant import SET_AT_S, STEP_NS, Actuators, Hull, Sender

HERE = Path(__file__).parent
HULL, SQUARE = HERE / "foreign_hull.toml", HERE / "foreign_square.toml"
CURRENT_MPS = (0.12, -0.16)
BEGUN_NS = 1_790_000_000_123_456_789
"""Its clock counts from 1970."""
DELAY_NS = 60_000_000
"""From the start of a cycle to the plan's arrival."""

HERE_AT_ZERO = Point(north_m=0.0, east_m=0.0)


def test_the_plant_imports_nothing_of_this_project() -> None:
    imported = set()
    for node in ast.walk(ast.parse((HERE / "foreign_plant.py").read_text())):
        if isinstance(node, ast.Import):
            imported |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported.add((node.module or "").partition(".")[0])
    assert imported - set(sys.stdlib_module_names) == {"msgpack", "zenoh"}


def test_its_hull_is_as_slow_and_as_slow_to_turn_as_the_issue_says() -> None:
    def steady(*command_N: float) -> list[float]:
        hull = Hull()
        for _ in range(2500):
            hull.step(command_N)
        return hull.x[7:13]

    assert steady(42.0, 42.0)[0] == pytest.approx(1.5, abs=0.01)
    assert 0.3 < steady(42.0, -38.0)[5] <= 0.4
    assert steady(0.0, 0.0) == [0.0] * 6


def test_without_thrust_and_drag_its_hull_keeps_its_energy() -> None:
    """Coriolis forces and the coupled added mass do no work; the integrator loses none."""
    plant = sys.modules[Hull.__module__]
    hull = Hull()
    hull.linear = hull.quadratic = (0.0,) * 6
    hull.fin = hull.righting_Nm = 0.0
    hull.x[7:13] = [0.8, -0.2, 0.1, 0.1, -0.2, 0.3]

    def energy() -> float:
        u, v, w, p, q, r = hull.x[7:13]
        M = np.diag([plant.SURGE, plant.SWAY, plant.HEAVE, plant.ROLL, plant.PITCH, plant.YAW])
        M[1, 5] = M[5, 1] = plant.COUPLED
        nu = np.array([u, v, w, p, q, r])
        return float(nu @ M @ nu)

    before = energy()
    for _ in range(500):
        hull.step((0.0, 0.0))
    assert energy() == pytest.approx(before, rel=1e-6)


class Flight:
    """Plant and controller at simulated time; every message passes the codec and the message validation as bytes."""

    def __init__(
        self,
        reference: Reference,
        *,
        config: ControllerConfig | None = None,
        reports: bool = True,
        heading_rad: float = 1.0,
    ) -> None:
        self.hull = Hull(heading_rad=heading_rad, current_mps=CURRENT_MPS)
        self.actuators, self.sender = Actuators(), Sender()
        self.node = ControllerNode(Vehicle.load(str(HULL)), reference, config or ControllerConfig())
        self.door = MessageValidator()
        self.track: list[tuple[float, float]] = []
        self.plans: list[dict[str, Any]] = []
        self._reports = reports
        self._sequence = 0
        self._t_ns = BEGUN_NS
        self._under_way: list[tuple[int, bytes]] = []

    def fly(self, seconds: float, **command: str) -> np.ndarray:
        """Fly for a time after a command and return all positions (M, 2), one each 20 ms."""
        inbox = [self._heard("command", {"command_id": len(self.track), **command}, self._t_ns)]
        for k in range(round(seconds * 1e9) // STEP_NS):
            t_ns = self._t_ns
            while self._under_way and self._under_way[0][0] <= t_ns:
                self.actuators.offer(msgpack.unpackb(self._under_way.pop(0)[1]), t_ns)
            if k % 5 == 0:
                inbox.append(self._heard("estimate", self.hull.estimate(t_ns), t_ns))
                if self._reports:
                    inbox.append(self._heard("applied", self.actuators.report(t_ns, self.hull.thrust_N), t_ns))
            if k % 15 == 0:
                self._cycle(t_ns, inbox)
                inbox = []
            self.hull.step(self.actuators.step(t_ns))
            self.track.append((self.hull.x[0], self.hull.x[1]))
            self._t_ns += STEP_NS
        assert self.door.rejected == 0, self.door.rejected_by_reason
        return np.array(self.track)

    def _heard(self, key: str, fields: dict[str, Any], t_ns: int) -> ReceivedMessage:
        signal, header = self.door.validate(Frame(BY_KEY[key], key, self.sender.pack(key, fields), 0))
        return ReceivedMessage(signal, header.epoch, header.sequence, t_ns)

    def _cycle(self, t_ns: int, inbox: list[ReceivedMessage]) -> None:
        for signal in step(self.node, t_ns, inbox):
            if key_of(type(signal), "controller") == "plan":
                payload = encode(signal, Header(epoch=1, sequence=self._sequence))
                self._sequence += 1
                self._under_way.append((t_ns + DELAY_NS, payload))
                self.plans.append(msgpack.unpackb(payload))


def distance(track: np.ndarray) -> np.ndarray:
    """Return the distance from the origin (m)."""
    return np.hypot(track[:, 0], track[:, 1])


def test_it_holds_a_point_in_a_current_that_nobody_tells() -> None:
    flight = Flight(HERE_AT_ZERO)
    flight.hull.x[0], flight.hull.x[1] = 3.0, -2.0
    off = distance(flight.fly(120.0, action="arm"))
    assert off[-4000:].max() <= 0.3  # from 40 s on
    assert {plan["origin"] for plan in flight.plans[1:]} == {"solved"}


def test_without_an_estimate_of_the_current_it_would_not() -> None:
    flight = Flight(HERE_AT_ZERO, config=ControllerConfig(disturbance=Disturbance(sd_mps=0.0)))
    assert distance(flight.fly(90.0, action="arm"))[-2500:].max() > 0.4


def test_it_holds_the_point_also_where_nobody_reports_the_thrusts() -> None:
    off = distance(Flight(HERE_AT_ZERO, reports=False).fly(90.0, action="arm"))
    assert off[-2500:].max() <= 0.3


CORNERS = np.array([[0.0, 0.0], [0.0, 20.0], [-20.0, 20.0], [-20.0, 0.0]])
SIDE_M, SPEED_MPS = 20.0, 1.0
NEAR_M = 3.0
"""From a corner: its arc, and the turn that begins before and ends after it."""


def off_the_square(track: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances (M,) of positions (M, 2) from the outline of the square and from its next corner."""
    legs = [
        np.linalg.norm(track - a - np.clip((track - a) @ (b - a) / SIDE_M**2, 0.0, 1.0)[:, None] * (b - a), axis=1)
        for a, b in zip(CORNERS, np.roll(CORNERS, -1, axis=0), strict=True)
    ]
    corners = np.linalg.norm(track[:, None, :] - CORNERS[None, :, :], axis=2)
    return np.min(legs, axis=0), corners.min(axis=1)


def test_it_follows_a_square_at_one_metre_a_second() -> None:
    """Start from a hover with the bow into the current; a message commands to follow."""
    flight = Flight(HERE_AT_ZERO, heading_rad=2.2)
    hovered = len(flight.fly(30.0, action="arm"))
    track = flight.fly(115.0, action="follow", reference_toml=SQUARE.read_text())[hovered:]
    t = STEP_NS * 1e-9 * np.arange(len(track))
    following = [plan for plan in flight.plans if plan["progress"] is not None]
    times = np.array([plan["t_ns"][0] - following[0]["t_ns"][0] for plan in following]) * 1e-9
    progress = np.array([plan["progress"] for plan in following])
    begins, ends = times[progress > 0.001][0], times[progress >= 0.999][0]
    assert ends - begins <= 1.25 * 4 * SIDE_M / SPEED_MPS
    lap = (t >= begins) & (t <= ends)
    off, corner = off_the_square(track[lap])
    assert off.max() <= 0.5
    assert off[corner > NEAR_M].max() <= 0.15
    # All round, in order: 4 sides of it were there to be off.
    assert [float(np.linalg.norm(track - at, axis=1).min()) < 0.6 for at in CORNERS] == [True] * 4


@pytest.mark.timeout(400)
def test_as_processes_it_holds_the_point_by_its_own_clock_which_is_set_back(tmp_path: Path) -> None:
    """Armed by message, in real time, its clock two hours ahead: within 0.3 m for 15 s from the step on."""
    (tmp_path / "point.toml").write_text('kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n')
    held = 0

    def has_held(line: str) -> bool:
        nonlocal held
        if line.startswith("{"):
            said = json.loads(line)
            off_m = math.hypot(said["north_m"], said["east_m"])
            if said["t_s"] >= SET_AT_S - 1.0:
                assert off_m <= 0.3, line
                assert said["authority"] == "controller"
                held += 1
        return held >= 15

    arguments = ("--vehicle", str(HULL), "--reference", str(tmp_path / "point.toml"))
    with (
        controller(loopback.free_port(), arguments) as (endpoint, console),
        started(sys.executable, "-P", str(HERE / "foreign_plant.py"), endpoint, "-5") as (_, plant),
    ):
        plant.until(has_held, within_s=240.0)
        console.until(lambda line: "was set by -" in line, within_s=5.0)
