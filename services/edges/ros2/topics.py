"""Table of the ROS 2 topics and services of the edge: name, type, direction, durability, meaning on this bus."""

from __future__ import annotations

import enum

import msgspec

from ltv_mpc.messages import Action


class Direction(enum.StrEnum):
    """Role of the edge on a topic or service, as in a liveliness token of rmw_zenoh."""

    IN = "MS"  # it subscribes
    OUT = "MP"  # it publishes
    SERVICE = "SS"  # it serves


IN, OUT, SERVICE = Direction.IN, Direction.OUT, Direction.SERVICE


class Row(msgspec.Struct, frozen=True):
    """Row of the table. ``latched`` is the durability transient local, with a depth of 1."""

    name: str
    topic: str
    ros_type: str
    direction: Direction
    meaning: str
    latched: bool = False


TABLE = (
    Row("odometry", "/odometry", "nav_msgs/msg/Odometry", IN, "`estimate`"),
    Row("pose", "/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", IN, "`estimate`, with `twist`"),
    Row("twist", "/twist", "geometry_msgs/msg/TwistWithCovarianceStamped", IN, "see `pose`; body frame"),
    Row("current", "/current", "geometry_msgs/msg/TwistStamped", IN, "`current` of the estimates, for 30 s"),
    Row("goal", "/goal_pose", "geometry_msgs/msg/PoseStamped", IN, "`command` follow, a point"),
    Row("route", "/route", "nav_msgs/msg/Path", IN, "`command` follow, waypoints"),
    Row("fence", "/fence", "std_msgs/msg/String", IN, "`command` fence, from GeoJSON; empty: none"),
    Row("obstacles", "/obstacles", "std_msgs/msg/String", IN, "`obstacles`, the fields of the message as JSON"),
    Row("port", "/thrusters/port/thrust", "std_msgs/msg/Float64", OUT, "thrust at that instant, N"),
    Row("starboard", "/thrusters/starboard/thrust", "std_msgs/msg/Float64", OUT, "the same"),
    Row("vertical", "/thrusters/vertical/thrust", "std_msgs/msg/Float64", OUT, "the same"),
    Row("thrusts", "/thrusters/thrusts", "std_msgs/msg/Float64MultiArray", OUT, "with `--array`, for the three"),
    Row("wrench", "/thrusters/wrench", "geometry_msgs/msg/WrenchStamped", OUT, "force and moment of the thrusters"),
    Row("path", "/plan", "nav_msgs/msg/Path", OUT, "predicted path of each `plan`"),
    Row("diagnostics", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", OUT, "`controller/status`, refusals"),
    Row("water", "/current_profile", "sensor_msgs/msg/PointCloud2", OUT, "`current` of the estimates, 1 Hz"),
    Row("zones", "/zones", "visualization_msgs/msg/MarkerArray", OUT, "`fence`: zones and obstacles in force"),
    Row("tf_static", "/tf_static", "tf2_msgs/msg/TFMessage", OUT, "reference point of the vehicle file", latched=True),
    Row("arm", "/ltv_mpc/arm", "std_srvs/srv/SetBool", SERVICE, "true: `arm`; false: `disarm`"),
    Row("hold", "/ltv_mpc/hold", "std_srvs/srv/SetBool", SERVICE, "true: `hold`; false is refused"),
    Row("stop", "/ltv_mpc/stop", "std_srvs/srv/Trigger", SERVICE, "`stop`"),
    Row("disarm", "/ltv_mpc/disarm", "std_srvs/srv/Trigger", SERVICE, "`disarm`"),
    Row("release", "/ltv_mpc/release", "std_srvs/srv/Trigger", SERVICE, "`release`"),
)

BY_NAME = {row.name: row for row in TABLE}

ACTIONS = {("arm", False): Action.DISARM} | {
    (action.value, True): action for action in (Action.ARM, Action.HOLD, Action.STOP, Action.DISARM, Action.RELEASE)
}
"""Command of each service and of its request's ``data``; a Trigger counts as True."""


def rows(names: dict[str, str], *, array: bool) -> tuple[Row, ...]:
    """Return the rows in use, with other topics by name. With ``array`` one topic has all thrusts."""
    unused = ("port", "starboard", "vertical") if array else ("thrusts",)
    return tuple(
        msgspec.structs.replace(row, topic=names.get(row.name, row.topic)) for row in TABLE if row.name not in unused
    )
