"""One walk as the owner of a boat: power-on, mission of a ground station, failsafe, MANUAL again, disarm.

    python -m benchmarks.owner_walk

Beside the simulated autopilot run router, controller, recorder, both edges, `watch` and the live page, as processes; a
ground station by pymavlink sends what an owner would. For each standstill the table has the time (s) from its cause,
as the autopilot's heartbeat tells it, to its sentence on each screen.
"""

from __future__ import annotations

import contextlib
import os
import pty
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import zenoh
from pymavlink.dialects.v20 import ardupilotmega as dialect
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from ltv_mpc.messages import Plan
from services.edges.ros2.middleware import RmwZenoh
from services.edges.ros2.topics import BY_NAME
from services.recording.acceptance import accepted
from services.recording.reader import Recording
from services.supervisor import loopback

CLI = (sys.executable, "-P", "-m", "services.cli")
AUTOPILOT = Path(__file__).parents[1] / "examples" / "python" / "simulated_autopilot.py"
CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|[\r\n\s]+")
SCREENS = ("controller", "mavlink", "watch", "page", "ros2", "station")
ADDRESS = re.compile(r"http://(\S+?)/#")
PATIENCE_S = 60.0
MANUAL, HOLD, CRITICAL = 0, 4, 5
PLACES = ((50.2, -5.1), (50.20004, -5.1), (50.20004, -5.09996))
OF_THE_EDGE = ("mavlink", "station")
"""Screens of what the controller itself was told to do."""


class Screens:
    """What each screen has shown, with the time of each text."""

    def __init__(self) -> None:
        self.shown: dict[str, list[tuple[float, str]]] = {screen: [] for screen in SCREENS}

    def show(self, screen: str, text: str) -> None:
        """Add a text."""
        self.shown.setdefault(screen, []).append((time.monotonic(), CONTROL.sub(" ", text)))

    def first(self, screen: str, sentence: str, since_s: float) -> float | None:
        """Return when a screen first showed a sentence; None: not yet."""
        return next((at_s for at_s, text in self.shown[screen] if at_s >= since_s and sentence in text), None)

    def awaited(self, sentence: str, since_s: float, screens: tuple[str, ...] = SCREENS) -> dict[str, float | None]:
        """Wait until the screens show a sentence; return the times since ``since_s`` (s), None where it never came."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline and any(self.first(one, sentence, since_s) is None for one in screens):
            time.sleep(0.05)
        found = {one: self.first(one, sentence, since_s) for one in screens}
        return {one: None if at_s is None else at_s - since_s for one, at_s in found.items()}


class Station:
    """Ground station at a UDP port, whose heartbeats can be stopped."""

    def __init__(self, port: int, screens: Screens) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._mav: Any = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self._screens, self._peer, self._pieces = screens, None, ""
        self.beats, self.items = True, list[Any]()
        self.state: tuple[bool, int, int] | None = None  # armed, mode, MAV_STATE
        self.reached, self.changed_s, self.lost_s = list[int](), 0.0, 0.0
        self.acknowledged = threading.Event()
        threading.Thread(target=self._listen, daemon=True).start()
        threading.Thread(target=self._beat, daemon=True).start()

    def send(self, name: str, *fields: Any) -> None:
        """Send a message."""
        if self._peer is not None:
            self._socket.sendto(bytes(getattr(self._mav, f"{name}_encode")(*fields).pack(self._mav)), self._peer)

    def command(self, number: int, *parameters: float) -> None:
        """Send a command to the autopilot."""
        self.send("command_long", 1, 1, number, 0, *parameters, *[0.0] * (7 - len(parameters)))

    def upload(self, *places: tuple[float, float]) -> None:
        """Send a mission of waypoints, home first."""
        self.items = [
            (1, 1, at, 6, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, round(latitude * 1e7), round(longitude * 1e7), 0.0)
            for at, (latitude, longitude) in enumerate(places)
        ]
        self.acknowledged.clear()
        self.send("mission_count", 1, 1, len(self.items), 0)
        assert self.acknowledged.wait(PATIENCE_S), "mission not accepted"

    def _beat(self) -> None:
        while True:
            if self.beats:
                self.send("heartbeat", 6, 8, 0, 0, 4)
            time.sleep(1.0)

    def _listen(self) -> None:
        while True:
            data, self._peer = self._socket.recvfrom(4096)
            with contextlib.suppress(dialect.MAVError):
                self._take(self._mav.decode(bytearray(data)))

    def _take(self, m: Any) -> None:
        match m.get_type():
            case "HEARTBEAT" if m.get_srcComponent() == 1:
                state = bool(m.base_mode & 0x80), m.custom_mode, m.system_status
                if state != self.state:
                    self.state, self.changed_s = state, time.monotonic()
            case "MISSION_REQUEST_INT" | "MISSION_REQUEST" if m.seq < len(self.items):
                self.send("mission_item_int", *self.items[m.seq])
            case "MISSION_ACK" if m.target_component == 190:
                self.acknowledged.set()
            case "MISSION_ITEM_REACHED":
                self.reached.append(m.seq)
            case "STATUSTEXT":
                self._pieces += m.text
                if m.id == 0 or len(m.text) < 50:
                    self._screens.show("station", self._pieces)
                    self._pieces = ""


def until(true: Callable[[], bool], within_s: float = PATIENCE_S) -> None:
    """Wait until something is true."""
    deadline = time.monotonic() + within_s
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@contextlib.contextmanager
def process(screens: Screens, name: str, *command: str, terminal: bool = False) -> Iterator[None]:
    """Run a process whose output is a screen."""
    reads, writes = pty.openpty() if terminal else os.pipe()
    environment = os.environ | {"COLUMNS": "160", "LINES": "60", "TERM": "xterm"}
    running = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=writes, stderr=writes, env=environment, start_new_session=True
    )
    os.close(writes)

    def read() -> None:
        with contextlib.suppress(OSError):
            while data := os.read(reads, 65_536):
                screens.show(name, data.decode(errors="replace"))

    threading.Thread(target=read, daemon=True).start()
    try:
        yield
    finally:
        running.terminate()
        running.wait(20.0)


def read_page(screens: Screens) -> None:
    """Read the stream of the live page, as its browser does."""
    found: list[str] = []
    until(
        lambda: bool(
            found.extend(one for _, text in screens.shown.get("dashboard", ()) for one in ADDRESS.findall(text))
            or found
        )
    )
    with (
        contextlib.suppress(ConnectionClosed),
        connect(f"ws://{found[0]}/stream", origin=f"http://{found[0]}", max_size=None) as page,
    ):  # type: ignore[arg-type]
        for text in page:
            screens.show("page", str(text))


class Walk:
    """The walk: what the owner does, and the table of what the screens said."""

    def __init__(self, screens: Screens, station: Station, endpoint: str) -> None:
        self.screens, self.station, self.endpoint = screens, station, endpoint

    def stands_still(self, cause: str, sentence: str, since_s: float, screens: tuple[str, ...] = SCREENS) -> None:
        """Print when each screen gave the reason."""
        found = self.screens.awaited(f"not driving: {sentence}", since_s, screens)
        cells = ["-" if one not in found else "never" if found[one] is None else f"{found[one]:.1f}" for one in SCREENS]
        print(f"| {cause} | {sentence} | {' | '.join(cells)} |", flush=True)

    def after(self, state: tuple[bool, int]) -> float:
        """Return when the heartbeat first had this state: armed, mode."""
        until(lambda: self.station.state is not None and self.station.state[:2] == state)
        return self.station.changed_s

    def control(self, command: str) -> None:
        """Give a command to the controller, until it is accepted."""
        words = (*CLI, "ctl", command, "--connect", self.endpoint)
        until(lambda: subprocess.run(words, capture_output=True, check=False).returncode == 0)

    def drives(self) -> None:
        """Arm the controller, and the autopilot in MANUAL, and wait until the edge drives."""
        since_s = time.monotonic()
        self.control("arm")
        self.station.command(176, 1.0, MANUAL)
        self.station.command(400, 1.0)
        until(lambda: self.screens.first("station", "LTV-MPC: driving", since_s) is not None)

    def run(self, power_on: Callable[[], object]) -> None:
        """Do it all."""
        station = self.station
        print(f"| cause | sentence | {' | '.join(SCREENS)} |\n|{'---|' * (2 + len(SCREENS))}")
        power_on()
        until(lambda: station.state is not None)
        self.stands_still("power-on", "autopilot disarmed; arm it", station.changed_s)
        station.upload(*PLACES)
        self.drives()
        until(lambda: 1 in station.reached)
        station.beats = False
        since_s = time.monotonic()
        until(lambda: self.screens.first("station", "not driving: ground station 255 lost", since_s) is not None)
        first_s = min(at for one in SCREENS if (at := self.screens.first(one, "ground station 255 lost", since_s)))
        self.stands_still("ground station silent", "ground station 255 lost", first_s)
        self.stands_still("failsafe", "autopilot in failsafe", self.after((True, HOLD)))
        station.beats = True
        self.stands_still("station back", "autopilot in mode HOLD; set MANUAL", self.after_failsafe())
        self.drives()
        until(lambda: len(PLACES) - 1 in station.reached)
        since_s = time.monotonic()
        self.control("disarm")
        disarmed_s = self.screens.first("controller", "disarmed", since_s)
        assert disarmed_s is not None
        self.stands_still("`ctl disarm`", "controller disarmed; ltv-mpc ctl arm", disarmed_s - 0.1, OF_THE_EDGE)
        self.drives()
        station.command(400, 0.0)
        self.stands_still("disarm", "autopilot disarmed; arm it", self.after((False, MANUAL)))

    def after_failsafe(self) -> float:
        """Return when the heartbeat first had no failsafe."""
        until(lambda: self.station.state is not None and self.station.state[2] < CRITICAL)
        return self.station.changed_s


def main() -> None:
    """Start everything, and walk."""
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    link, ground = loopback.free_port(), loopback.free_port()
    screens = Screens()
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:

        def start(name: str, *words: str, terminal: bool = False) -> None:
            stack.enter_context(process(screens, name, *CLI, *words, "--connect", endpoint, terminal=terminal))

        stack.enter_context(process(screens, "router", *CLI, "router", "--listen", endpoint))
        until(lambda: any("ready at" in text for _, text in screens.shown.get("router", ())))
        stack.enter_context(contextlib.chdir(folder))
        start("controller", "controller", "--vehicle", "bluerobotics-boat", "--reference", "hover")
        start("recorder", "recorder")
        start("ros2", "ros2", "--middleware", "rmw_zenoh")
        start("dashboard", "dashboard", "--port", "0")
        start("watch", "watch", terminal=True)
        start("mavlink", "mavlink", "--autopilot", f"udpin:127.0.0.1:{link}")
        settings = zenoh.Config()
        settings.insert_json5("mode", '"client"')
        settings.insert_json5("connect/endpoints", f'["{endpoint}"]')
        session = stack.enter_context(zenoh.open(settings))
        diagnostics = RmwZenoh(0).key(BY_NAME["diagnostics"])
        _subscriber = session.declare_subscriber(
            diagnostics, lambda sample: screens.show("ros2", sample.payload.to_bytes().decode("ascii", "replace"))
        )
        threading.Thread(target=read_page, args=(screens,), daemon=True).start()
        until(lambda: any("waiting for" in text for _, text in screens.shown["controller"]), 300.0)
        until(lambda: any("listens at" in text for _, text in screens.shown["mavlink"]))
        station = Station(ground, screens)
        autopilot = (sys.executable, "-P", str(AUTOPILOT), *(f"udpout:127.0.0.1:{port}" for port in (link, ground)))
        Walk(screens, station, endpoint).run(lambda: stack.enter_context(process(screens, "autopilot", *autopilot)))
        stack.close()
        (run,) = (one for one in (Path(folder) / "runs").iterdir() if not one.is_symlink())
        plans = (message for message, _, _ in accepted(Recording(run / "run.mcap"), (Plan,)))
        recorded = {plan.health_why: None for plan in plans if isinstance(plan, Plan) and plan.health_why}
        print("recorded:", *recorded, sep="\n  ")


if __name__ == "__main__":
    main()
