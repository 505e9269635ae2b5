"""Foreign craft through each edge, beside the Zenoh protocol: python -m benchmarks.edges [CONNECTION ...]

The craft holds a point for 20 s and drives its square once, as processes in real time: the craft, the edge, a
controller and a router. The connections are

zenoh     the protocol itself
ros2      `ltv-mpc ros2 --middleware rmw_zenoh`; the craft is a ROS 2 node by zenoh-ros2-sdk
mavlink   `ltv-mpc mavlink`; the craft is behind the simulated autopilot

Each takes about two minutes. All delays are differences of the monotonic clock, which the processes of a host share:

estimate  from the publication by the craft to the arrival of ``estimate`` at a reader of this bus
thrust    from the publication of a plan to the next thrust, override or plan that reaches the craft
"""

from __future__ import annotations

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

import msgpack
import msgspec
import numpy as np

from ltv_mpc.config import to_toml
from ltv_mpc.messages import Estimate, NodeStatus, Plan
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.session import open_session
from services.bus.topics import BY_TYPE, expression
from services.bus.wire import decode
from services.runtime.stopping import StopRequest
from services.supervisor import loopback
from tests.foreign_plant.flight import CURRENT_MPS, HULL, SQUARE, distance_m
from tests.foreign_plant.plant import MAX_N, MIN_N, STEP_NS, Actuators, Hull, Sender, _rotation
from tests.foreign_plant.scenarios.square import distance_from_outline_m
from tests.system.alone import CLI, controller, started

CONNECTIONS = ("zenoh", "ros2", "mavlink")
DOMAIN_ID = 9
APPROACH_S, HOLD_S, LAP_S = 20.0, 20.0, 110.0
START_M, START_HEADING_RAD = (1.5, -1.0), 2.2
"""Near the point, and with the bow into the current, so that the square begins with the bow near its course."""
ACCURACY = "0.01,0.002,0.005,0.002"
"""``--sd`` of the edge to MAVLink: the estimates are exact, as those of the other connections, which send no
covariance. With the default of 0.1 m/s the controller learns the current over half a minute, and holds the point 3 cm
worse.
"""

ESTIMATE_STEPS = 5
"""Steps of the craft from one estimate to the next: 0.1 s, as from the autopilot."""

COMPLETE = 0.999
STATUS_S = 1.0
"""Wait for the last status of the edge, which it publishes every 0.5 s."""


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one connection. Errors are mean and largest distance, delays median and 99th percentile."""

    connection: str
    hold_m: tuple[float, float]  # from the point
    square_m: tuple[float, float]  # from the outline of the square
    progress: float  # of the square
    estimate_ms: tuple[float, float]
    thrust_ms: tuple[float, float]
    estimates: int  # published by the craft
    estimates_missing: int  # of them not on the bus
    lost: int  # frames, as the process counts them that receives from the craft
    refused: int


# --- the craft, a process of its own ---------------------------------------------------------------------------------


class Log:
    """Lines of JSON: each published estimate with its stamp and true position, and the arrival of each thrust."""

    def __init__(self, file: TextIO) -> None:
        self._file, self._lock = file, threading.Lock()

    def estimate(self, t_ns: int, hull: Hull) -> None:
        """Add an estimate that is published now."""
        self._add({"at_ns": time.monotonic_ns(), "t_ns": t_ns, "position_m": hull.x[:2]})

    def thrust(self) -> None:
        """Add a thrust that has arrived."""
        self._add({"at_ns": time.monotonic_ns()})

    def _add(self, line: dict[str, Any]) -> None:
        with self._lock:
            self._file.write(json.dumps(line) + "\n")
            self._file.flush()


def run_craft(connection: str, port: int, log: Log) -> None:
    """Run the craft until it is ended."""
    hull = Hull(heading_rad=START_HEADING_RAD, current_mps=CURRENT_MPS)
    hull.x[0], hull.x[1] = START_M
    {"zenoh": _over_zenoh, "ros2": _over_ros2, "mavlink": _over_mavlink}[connection](hull, port, log)


def _step_in_real_time(
    hull: Hull, command: Callable[[int], tuple[float, float]], publish: Callable[[int], None]
) -> None:
    due_ns, number = time.time_ns(), 0
    while True:
        hull.step(command(due_ns))
        if number % ESTIMATE_STEPS == 0:
            publish(due_ns)
        due_ns, number = due_ns + STEP_NS, number + 1
        time.sleep(max(0, due_ns - time.time_ns()) * 1e-9)


def _over_zenoh(hull: Hull, port: int, log: Log) -> None:
    import zenoh

    config, actuators, sender, lock = zenoh.Config(), Actuators(), Sender(), threading.Lock()
    for key, value in (
        ("mode", "client"),
        ("connect/endpoints", [f"tcp/127.0.0.1:{port}"]),
        ("scouting/multicast/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        publishers = {key: session.declare_publisher(key) for key in ("estimate", "applied")}

        def on_plan(sample: zenoh.Sample) -> None:
            log.thrust()
            with lock:
                actuators.offer(msgpack.unpackb(sample.payload.to_bytes()), time.time_ns())

        def command(due_ns: int) -> tuple[float, float]:
            with lock:
                return actuators.step(due_ns)

        def publish(due_ns: int) -> None:
            log.estimate(due_ns, hull)
            publishers["estimate"].put(sender.pack("estimate", hull.estimate(due_ns)))
            with lock:
                report = actuators.report(time.time_ns(), hull.thrust_N)
            publishers["applied"].put(sender.pack("applied", report))

        session.declare_subscriber("plan", on_plan)
        _step_in_real_time(hull, command, publish)


def _over_ros2(hull: Hull, port: int, log: Log) -> None:
    from tests.services.edges.ros2.sdk import Node, prepare

    with tempfile.TemporaryDirectory() as folder:
        prepare(Path(folder))
        node = Node(port, DOMAIN_ID)
        thrust_N = {"port": 0.0, "starboard": 0.0}
        publisher = node.publisher("/odometry", "nav_msgs/msg/Odometry")

        def receiver(name: str) -> Callable[[Any], None]:
            def on_thrust(message: Any) -> None:
                thrust_N[name] = min(max(message.data, MIN_N), MAX_N)
                if name == "port":  # the edge publishes it first
                    log.thrust()

            return on_thrust

        def publish(due_ns: int) -> None:
            log.estimate(due_ns, hull)
            publisher.publish(**node.odometry(due_ns, *_enu(hull)))

        for name in thrust_N:
            node.subscribe(f"/thrusters/{name}/thrust", "std_msgs/msg/Float64", receiver(name))
        _step_in_real_time(hull, lambda _: (thrust_N["port"], thrust_N["starboard"]), publish)


def _enu(hull: Hull) -> tuple[Any, ...]:
    """Return position, quaternion (x, y, z, w), velocity and angular velocity in the frames of ROS, ENU and FLU."""
    north, east, down, w, x, y, z, *_, p, q, r, _, _ = hull.x
    s = 0.5**0.5  # half a turn about (1, 1, 0) on the left, about x on the right
    quaternion = (s * (x + y), s * (x - y), s * (w - z), s * (w + z))
    R = np.array(_rotation(w, x, y, z))
    surge, sway, heave = hull.x[7:10] + R.T @ (*hull.current, 0.0)
    return (east, north, -down), quaternion, (surge, -sway, -heave), (p, -q, -r)


def _over_mavlink(hull: Hull, port: int, log: Log) -> None:
    from tests.foreign_plant.mavlink_flight import EXAMPLE, GCS, GCS_LINK, Craft, dialect

    station = dialect.MAVLink(None, srcSystem=GCS, srcComponent=190)

    class Autopilot(EXAMPLE.Autopilot):  # type: ignore[name-defined, misc]
        """Simulated autopilot with its ground station, which arms it."""

        def step(self) -> Any:
            datagrams = []
            for message in self._from_station():
                datagrams += self.receive(bytes(message.pack(station)), GCS_LINK)
            datagrams += super().step()
            if self.sent_s.get(32) == self.now_s:  # LOCAL_POSITION_NED
                log.estimate(self.ms * 1_000_000, hull)
            return datagrams

        def _from_station(self) -> Iterator[Any]:
            if self.ms % 1000 == 0:
                yield station.heartbeat_encode(6, 8, 0, 0, 4)
            if not self.armed:
                yield station.command_long_encode(1, 1, 400, 0, 1.0, 0, 0, 0, 0, 0, 0)

        def handle(self, m: Any, link: int) -> Any:
            if m.get_type() == "RC_CHANNELS_OVERRIDE":
                log.thrust()
            return super().handle(m, link)

    EXAMPLE.main([f"udpout:127.0.0.1:{port}"], Autopilot(Craft(hull), gcs_sysid=GCS))


# --- the run ---------------------------------------------------------------------------------------------------------


class Reader:
    """Reader of the bus: arrivals of estimates, publications of plans, and the newest status of each process."""

    def __init__(self) -> None:
        self.mailbox = Mailbox()
        self.arrived_ns: dict[int, int] = {}  # by stamp
        self.plans_ns: list[int] = []
        self.progress = 0.0
        self.status: dict[str, NodeStatus] = {}

    def until(self, is_done: Callable[[], Any], within_s: float) -> bool:
        """Read until something is true. Return False if it is not within this time."""
        end_s = time.monotonic() + within_s
        while not is_done():
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return False
            frame = self.mailbox.take(min(left_s, 0.5))
            if frame is None or frame.topic is None:
                continue
            message, header = decode(frame.topic.message_type, frame.payload)
            match message:
                case Estimate():
                    self.arrived_ns[message.t_ns] = frame.received_monotonic_us * 1000
                case Plan():
                    self.plans_ns.append(header.sent_monotonic_us * 1000)
                    self.progress = message.progress or 0.0
                case NodeStatus():
                    self.status[message.node] = message
        return True

    def read(self, seconds: float) -> None:
        """Read for a time."""
        self.until(lambda: False, seconds)


def measure(
    connection: str, folder: Path, *, approach_s: float = APPROACH_S, hold_s: float = HOLD_S, lap_s: float = LAP_S
) -> Figures:
    """Run the processes of one connection and return its figures.

    Parameters
    ----------
    connection : one of ``CONNECTIONS``.
    folder : empty folder for the files of the run.
    approach_s, hold_s : time until the point is reached, and time of the hold (s).
    lap_s : largest time for the square (s).
    """
    settings, point, log = folder / "settings.toml", folder / "point.toml", folder / "craft.json"
    settings.write_text('effort = "high"\n')
    point.write_text('kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n')
    arguments = ["--vehicle", str(HULL), "--reference", str(point), "--settings", str(settings)]
    port, udp = loopback.free_port(), loopback.free_port()
    with contextlib.ExitStack() as stack:
        endpoint, _ = stack.enter_context(controller(port, arguments))
        bus = stack.enter_context(open_session(BusOptions(connect=(endpoint,)), stop=StopRequest(), say=print))
        reader = Reader()
        for kind in (Estimate, Plan, NodeStatus):
            bus.subscribe(expression(BY_TYPE[kind]), BY_TYPE[kind], reader.mailbox)
        if edge := _edge(connection, endpoint, udp, folder):
            _, output = stack.enter_context(started(*CLI, *edge))
            output.until(lambda line: "writes" in line or "listens" in line)
        command = (sys.executable, "-P", "-m", "benchmarks.edges", "--craft", connection, "--log", str(log))
        stack.enter_context(started(*command, "--port", str(udp if connection == "mavlink" else port)))
        if not reader.until(lambda: reader.arrived_ns, 60.0):
            raise SystemExit(f"{connection}: no estimate on the bus within 60 s")
        _ctl("arm", endpoint)
        reader.read(approach_s)
        hold_ns = time.monotonic_ns()
        reader.read(hold_s)
        square_ns = time.monotonic_ns()
        _ctl("follow", str(SQUARE), endpoint)
        reader.until(lambda: 0.0 < reader.progress < COMPLETE, lap_s)  # the point has a progress of its own
        reader.until(lambda: reader.progress >= COMPLETE, lap_s)
        end_ns = time.monotonic_ns()
        reader.read(STATUS_S)
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    return figures(connection, lines, reader, (hold_ns, square_ns, end_ns))


def _edge(connection: str, endpoint: str, udp: int, folder: Path) -> tuple[str, ...]:
    """Return the command of the edge; empty without one."""
    if connection == "ros2":
        return ("ros2", "--middleware", "rmw_zenoh", "--domain-id", str(DOMAIN_ID), "--connect", endpoint)
    if connection == "mavlink":
        from tests.foreign_plant.mavlink_flight import vehicle

        boat = folder / "boat.toml"
        boat.write_text(to_toml(vehicle()))
        link = ("--autopilot", f"udpin:127.0.0.1:{udp}", "--connect", endpoint)
        return ("mavlink", *link, "--vehicle", str(boat), "--sd", ACCURACY)
    return ()


def _ctl(*command: str) -> None:
    """Send a command, again while the controller rejects it. The last argument is the endpoint."""
    *words, endpoint = command
    for _ in range(20):
        done = subprocess.run(
            (*CLI, "ctl", *words, "--connect", endpoint), capture_output=True, text=True, check=False, timeout=60.0
        )
        if done.returncode == 0:
            return
        time.sleep(0.5)
    raise SystemExit(f"ctl {' '.join(words)}: {done.stdout}{done.stderr}")


def figures(
    connection: str, lines: Sequence[dict[str, Any]], reader: Reader, times_ns: tuple[int, int, int]
) -> Figures:
    """Return the figures of a run.

    Parameters
    ----------
    connection : its name.
    lines : log of the craft.
    reader : what was read of the bus.
    times_ns : monotonic times at which the hold and the square begin, and at which the square ends.
    """
    hold_ns, square_ns, end_ns = times_ns
    estimates = [line for line in lines if "t_ns" in line and hold_ns <= line["at_ns"] < end_ns]
    thrusts_ns = np.array([line["at_ns"] for line in lines if "t_ns" not in line])
    plans_ns = np.array([at for at in reader.plans_ns if hold_ns <= at < end_ns])
    next_thrust = np.searchsorted(thrusts_ns, plans_ns)
    followed = next_thrust < len(thrusts_ns)
    arrived = [line for line in estimates if line["t_ns"] in reader.arrived_ns]
    delays_ns = np.array([reader.arrived_ns[line["t_ns"]] - line["at_ns"] for line in arrived])
    track = np.array([line["position_m"] for line in estimates])
    at_ns = np.array([line["at_ns"] for line in estimates])
    receiver = reader.status["controller" if connection == "zenoh" else connection]
    return Figures(
        connection=connection,
        hold_m=_mean_and_largest(distance_m(track[at_ns < square_ns])),
        square_m=_mean_and_largest(distance_from_outline_m(track[at_ns >= square_ns])),
        progress=reader.progress,
        estimate_ms=_quantiles_ms(delays_ns),
        thrust_ms=_quantiles_ms(thrusts_ns[next_thrust[followed]] - plans_ns[followed]),
        estimates=len(estimates),
        estimates_missing=len(estimates) - len(arrived),
        lost=receiver.dropped,
        refused=receiver.rejected,
    )


def _mean_and_largest(distance_m_: Any) -> tuple[float, float]:
    return float(distance_m_.mean()), float(distance_m_.max())


def _quantiles_ms(delays_ns: Any) -> tuple[float, float]:
    median, high = np.quantile(delays_ns, (0.5, 0.99)) * 1e-6
    return float(median), float(high)


def text(rows: Sequence[Figures]) -> str:
    """Format a table with a row for each connection."""
    names = (
        "connection",
        "hold: mean, largest (m)",
        "square: mean, largest (m)",
        "estimate: median, p99 (ms)",
        "thrust: median, p99 (ms)",
        "estimates missing",
        "frames lost",
        "refused",
    )
    lines = [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]
    for row in rows:
        distances = " | ".join(f"{mean:.3f}, {largest:.3f}" for mean, largest in (row.hold_m, row.square_m))
        delays = " | ".join(f"{median:.1f}, {high:.1f}" for median, high in (row.estimate_ms, row.thrust_ms))
        counts = f"{row.estimates_missing} of {row.estimates} | {row.lost} | {row.refused}"
        lines.append(f"| `{row.connection}` | {distances} | {delays} | {counts} |")
    return "\n".join(lines)


def main() -> int:
    """Measure the connections one after the other and print the table. Exit code 1: a square was not completed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("connections", nargs="*", metavar="CONNECTION", help="zenoh, ros2 or mavlink; default: all")
    parser.add_argument("--craft", choices=CONNECTIONS, help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--log", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.craft:
        with options.log.open("w") as file:
            run_craft(options.craft, options.port, Log(file))
    if unknown := set(options.connections) - set(CONNECTIONS):
        parser.error(f"no connection named {', '.join(sorted(unknown))}; known: {', '.join(CONNECTIONS)}")
    rows: list[Figures] = []
    for connection in options.connections or CONNECTIONS:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(measure(connection, Path(folder)))
        new = text(rows).splitlines()[0 if len(rows) == 1 else -1 :]
        print("\n".join(new), flush=True)  # a later failure does not lose it
    return 0 if all(row.progress >= COMPLETE for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
