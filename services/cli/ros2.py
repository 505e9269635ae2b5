"""Command ``ros2``: edge to ROS 2."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from services.cli.bus import check_namespace, with_bus
from services.cli.options import invalid, needs, option

if TYPE_CHECKING:
    from collections.abc import Iterable

    from services.bus.options import BusOptions
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
    import math

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
