"""Command ``ros2``: bridge to ROS 2."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.bus import check_namespace, with_bus

if TYPE_CHECKING:
    from services.bus.options import BusOptions


@with_bus(without=["certs"])
def ros2(
    odometry: Annotated[
        str, typer.Option("--odometry", metavar="TOPIC", help="Topic of nav_msgs/Odometry, ENU and FLU.")
    ] = "/odometry",
    thrusts: Annotated[
        str,
        typer.Option(
            "--thrusts",
            metavar="PORT,STARBOARD,VERTICAL",
            help="Topics of std_msgs/Float64, one for each thruster (N).",
        ),
    ] = "/thrusters/port/thrust,/thrusters/starboard/thrust,/thrusters/vertical/thrust",
    ros_namespace: Annotated[
        str, typer.Option("--ros-namespace", metavar="NAME", help="Namespace of the bridge, the prefix of its keys.")
    ] = "",
    rate_hz: Annotated[
        float, typer.Option("--rate-hz", metavar="R", help="Rate of the forces (Hz).", min=1.0, max=200.0)
    ] = 20.0,
    *,
    bus: BusOptions,
) -> int:
    """Connect to ROS 2: odometry in, thrusts out.

    Uses zenoh-bridge-ros2dds. Reads plan and the odometry topic; writes estimate and the topics of the thrusters. It
    replaces the estimator.
    """
    import re

    from ltv_mpc.errors import ConfigError

    names = tuple(thrusts.split(","))
    if len(names) != 3 or len({*names, odometry}) != 4:
        raise ConfigError("option --thrusts", "", "must be three topics, PORT,STARBOARD,VERTICAL", value=thrusts)
    for option, name in (("--odometry", odometry), *(("--thrusts", name) for name in names)):
        if not re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", name):
            raise ConfigError(
                f"option {option}", "", "must be the full name of a topic, such as /auv/odometry", value=name
            )
    check_namespace(ros_namespace, "--ros-namespace")
    try:
        from services.processes import ros2 as node
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("rosbags"):
            raise
        problem = "needs the package rosbags: pip install rosbags (extra ros2)"
        raise ConfigError("ltv-mpc ros2", "", problem) from None
    port, starboard, vertical = names
    topics = node.Topics(odometry=odometry, thrusts=(port, starboard, vertical))
    return node.main(topics, bus, ros_namespace=ros_namespace, rate_hz=rate_hz)
