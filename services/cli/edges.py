"""Panel "Your vehicle", edges: ``ros2`` to ROS 2 and ``mavlink`` to ArduPilot."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from services.cli.options import BusOptions, check_namespace, flag, invalid, needs, option, with_bus

if TYPE_CHECKING:
    from services.edges.mavlink.navigation import Accuracy
    from services.edges.ros2.topics import Row


DDS, RMW_ZENOH = "ros2dds", "rmw_zenoh"


@with_bus("ros2")
def ros2(
    middleware: Annotated[
        str, option(f"{DDS}|{RMW_ZENOH}", "zenoh-bridge-ros2dds, or ROS 2 nodes with rmw_zenoh.")
    ] = DDS,
    domain_id: Annotated[int, option("D", "ROS_DOMAIN_ID, for rmw_zenoh.", min=0, max=232)] = 0,
    topic: Annotated[
        list[str] | None, option("NAME=/TOPIC", "Other topic for a row of docs/ros2.md; repeatable.")
    ] = None,
    array: Annotated[str, option("ORDER", "One Float64MultiArray, such as port,starboard.")] = "",
    scale: Annotated[float, option("S", "Factor of that array, per N.")] = 1.0,
    vehicle: Annotated[str, option("NAME|FILE", "Vehicle, for its arms and its reference point.")] = "paper",
    speed_mps: Annotated[float, option("V", "Speed on a route (m/s).", min=0.01, max=20.0)] = 0.5,
    ros_namespace: Annotated[str, option("NAME", "Namespace of the bridge, the prefix of its keys.")] = "",
    rate_hz: Annotated[float, option("R", "Rate of the thrusts (Hz).", min=1.0, max=200.0)] = 20.0,
    *,
    bus: BusOptions,
) -> int:
    """Connect to ROS 2: odometry and goals in, thrusts out.

    Reads plan, controller/status and topics; writes estimate, command, applied and topics. It replaces the estimator.
    """
    from msgspec import structs

    from ltv_mpc.vehicle.parameters import Vehicle
    from services.bus.session import configuration

    _check(middleware, bus)
    with needs("rosbags", "ros2", "ros2"):
        from services.edges.ros2.conversions import Settings
        from services.processes import ros2 as process
    check_namespace(ros_namespace, "--ros-namespace")
    ros = structs.replace(bus, namespace=ros_namespace, role=f"ros-{domain_id}", timestamps=True)
    configuration(ros)  # its certificate is checked before anything starts
    config = process.Config(
        bus=bus,
        ros=ros,
        rows=_rows(topic or (), array, scale),
        domain_id=domain_id if middleware == RMW_ZENOH else None,
        edge=Settings(vehicle=Vehicle.load(vehicle), speed_mps=speed_mps, array=array, scale=scale),
        rate_hz=rate_hz,
    )
    return process.main(config)


def _check(middleware: str, bus: BusOptions) -> None:
    """Raise ``ConfigError`` for an unknown middleware, or one that cannot use certificates."""
    if middleware not in (DDS, RMW_ZENOH):
        raise invalid("option --middleware", f"must be {DDS} or {RMW_ZENOH}", value=middleware)
    if bus.certs is not None and middleware == DDS:
        problem = f"only with --middleware {RMW_ZENOH}: the keys of the bridge have no domain, and so no role"
        raise invalid("option --certs", problem)


def _rows(topics: Iterable[str], array: str, scale: float) -> tuple[Row, ...]:
    """Return the rows in use, with the topics of --topic. Raises ``ConfigError``."""
    from services.edges.ros2.middleware import is_topic
    from services.edges.ros2.topics import BY_NAME, rows

    names = {}
    for given in topics:
        name, _, of = given.partition("=")
        if name not in BY_NAME or not is_topic(of):
            problem = f"must be NAME=/TOPIC, NAME one of {', '.join(BY_NAME)}"
            raise invalid("option --topic", problem, value=given)
        names[name] = of
    used = rows(names, array=bool(array))
    if twice := sorted({row.topic for row in used if sum(row.topic == other.topic for other in used) > 1}):
        raise invalid("option --topic", "used for several rows", value=", ".join(twice))
    order = array.split(",") if array else []
    if not set(order) <= {"port", "starboard", "vertical"} or len(set(order)) < len(order):
        raise invalid("option --array", "must be names of port, starboard, vertical", value=array)
    if not (math.isfinite(scale) and scale != 0.0):
        raise invalid("option --scale", "must be a number other than 0", value=str(scale))
    return used


@with_bus("mavlink")
def mavlink(
    autopilot: Annotated[
        str, option("udpin|udpout:HOST:PORT", "Where the autopilot sends, or listens.")
    ] = "udpin:127.0.0.1:14550",
    gcs_sysid: Annotated[int, option("N", "MAV_GCS_SYSID of the autopilot.", min=1, max=255)] = 255,
    vehicle: Annotated[
        str, option("NAME|FILE", "Vehicle, with pwm_us and pwm_N of each thruster.")
    ] = "bluerobotics-boat",
    signing_key: Annotated[Path | None, option("FILE", "32 bytes: signed frames alone, both ways.")] = None,
    sd: Annotated[
        str, option("P,V,H,R", "Standard deviations that it does not send: m, m/s, rad, rad/s of yaw.")
    ] = "1,0.1,0.05,0.01",
    no_mission: Annotated[bool, flag("--no-mission", "Ignore the mission and the fence of the autopilot.")] = False,
    *,
    bus: BusOptions,
) -> int:
    """Connect to ArduPilot: position in, thrusts out.

    Reads plan and controller/status; writes estimate, command and applied. It replaces the estimator.
    """
    from ltv_mpc.vehicle.parameters import Vehicle

    with needs("pymavlink", "mavlink", "mavlink"):
        from services.edges.mavlink.edge import Settings
        from services.processes import mavlink as process
    host, port, listens = _address(autopilot)
    of = Vehicle.load(vehicle)
    if missing := [n for n, t in (("port", of.thruster.port), ("starboard", of.thruster.starboard)) if not t.pwm_us]:
        problem = f"[thruster.{missing[0]}] has no pwm_us and pwm_N: the vehicle bluerobotics-boat has them"
        raise invalid(f"vehicle {vehicle}", problem)
    key = None if signing_key is None else _key(signing_key)
    edge = Settings(vehicle=of, ground_station=gcs_sysid, accuracy=_accuracy(sd), follow_mission=not no_mission)
    config = process.Config(bus=bus, host=host, port=port, listens=listens, edge=edge, signing_key=key)
    return process.main(config)


def _accuracy(text: str) -> Accuracy:
    """Return the standard deviations of a text. Raises ``ConfigError``."""
    from services.edges.mavlink.navigation import Accuracy

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 4 or not all(0.0 < value < 1e3 for value in values):
        raise invalid("option --sd", "must be four numbers above 0, as in 1,0.1,0.05,0.01", value=text)
    return Accuracy(*values)


def _key(path: Path) -> bytes:
    """Return the 32 bytes of a file. Raises ``ConfigError``."""
    from ltv_mpc.config import read_bytes

    key = read_bytes(path, what="option --signing-key")
    if len(key) != 32:
        raise invalid(f"option --signing-key {path}", f"has {len(key)} bytes, must be 32")
    return key


def _address(text: str) -> tuple[str, int, bool]:
    """Return host, port, and whether the edge listens there. Raises ``ConfigError``."""
    found = re.fullmatch("(udpin|udpout):(.+):([0-9]{1,5})", text)
    if found is None or not 1 <= int(found[3]) <= 65_535:
        problem = "must be udpin:HOST:PORT or udpout:HOST:PORT, as in udpin:127.0.0.1:14550"
        raise invalid("option --autopilot", problem, value=text)
    return found[2], int(found[3]), found[1] == "udpin"
