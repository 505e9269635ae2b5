"""Edge to ROS 2: goals, current, poses and requests in; thrusts, path, diagnostics, water and transform out."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from ltv_mpc import config, references
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.messages import (
    Acknowledgement,
    Action,
    Applied,
    Authority,
    Command,
    CurrentProfile,
    Estimate,
    FenceInForce,
    FenceReport,
    Health,
)
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.reference_point import ReferencePoint
from services.edges.edge import Outgoing, Received, Refused
from services.edges.ros2 import cdr
from services.edges.ros2.conversions import Settings
from services.edges.ros2.edge import Ros2Edge
from services.edges.ros2.middleware import Attachment
from services.edges.ros2.topics import BY_NAME
from tests.fuzz.targets import SQUARE_FENCE
from tests.services.bus.messages import EXAMPLES
from tests.services.controller_status import status
from tests.services.edges.plans import SECOND_NS, plan
from tests.services.edges.ros2.test_ros2 import odometry

PAPER = Vehicle.load("paper")
T_NS = 1_700_000_000_250_000_000


def edge_with(**settings: Any) -> Ros2Edge:
    return Ros2Edge(1, Settings(vehicle=PAPER, **settings))


def stamped(at_s: float = 0.0, frame: str = "odom") -> Any:
    sec, nanosec = divmod(T_NS + round(at_s * 1e9), SECOND_NS)
    time = cdr.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return cdr.make("std_msgs/msg/Header", stamp=time, frame_id=frame)


def vector(kind: str, x: float, y: float, z: float) -> Any:
    return cdr.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def pose(x: float, y: float, z: float, yaw: float = 0.0) -> Any:
    turn = cdr.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
    return cdr.make("geometry_msgs/msg/Pose", position=vector("Point", x, y, z), orientation=turn)


def twist(x: float, y: float, z: float) -> Any:
    return cdr.make(
        "geometry_msgs/msg/Twist", linear=vector("Vector3", x, y, z), angular=vector("Vector3", 0.0, 0.0, 0.1)
    )


def give(edge: Ros2Edge, channel: str, message: Any, now_us: int = 0, attachment: bytes = b"") -> list[Any]:
    return edge.receive(Received(channel, cdr.encode(message), attachment, now_us))


def read_reference(command: Command) -> references.Reference:
    """Read the reference of a command as the controller does."""
    reference: references.Reference = config.parse(
        config.loads(command.reference_toml), references.Reference, source="reference"
    )
    return reference


def read(frames: Any, name: str) -> Any:
    (payload,) = (frame.payload for frame in frames if isinstance(frame, Outgoing) and frame.channel == name)
    return cdr.decode(payload, BY_NAME[name].ros_type)


# --- in --------------------------------------------------------------------------------------------------------------


def with_pose(at_s: float = 0.0) -> Any:
    inner = cdr.make(
        "geometry_msgs/msg/PoseWithCovariance", pose=pose(3.0, 4.0, -5.0, math.pi / 2), covariance=np.zeros(36)
    )
    return cdr.make("geometry_msgs/msg/PoseWithCovarianceStamped", header=stamped(at_s), pose=inner)


def with_twist(at_s: float = 0.0) -> Any:
    inner = cdr.make("geometry_msgs/msg/TwistWithCovariance", twist=twist(1.0, 0.0, 0.0), covariance=np.zeros(36))
    header = stamped(at_s, "base_link")
    return cdr.make("geometry_msgs/msg/TwistWithCovarianceStamped", header=header, twist=inner)


def test_a_pose_and_its_twist_are_an_estimate() -> None:
    edge = edge_with()
    assert give(edge, "pose", with_pose()) == []  # without a twist it is refused
    assert edge.refused == 1
    assert give(edge, "twist", with_twist(-0.1)) == []
    (estimate,) = give(edge, "pose", with_pose())
    assert (estimate.north_m, estimate.east_m, estimate.depth_m, estimate.t_ns) == (4.0, 3.0, 5.0, T_NS)
    assert estimate.velocity_north_mps == pytest.approx(1.0)
    assert give(edge, "pose", with_pose(0.2)) == []  # the twist is 0.3 s old
    assert edge.refused == 2


def test_poses_beside_odometry_are_refused() -> None:
    edge = edge_with()
    assert edge.receive(Received("odometry", odometry(), b"", 0))
    give(edge, "twist", with_twist())
    assert give(edge, "pose", with_pose()) == []
    assert edge.reason == "pose: the odometry is in use"


def test_the_current_is_added_to_the_estimates_for_thirty_seconds() -> None:
    edge = edge_with()
    water = cdr.make("geometry_msgs/msg/TwistStamped", header=stamped(), twist=twist(0.3, -0.1, 0.0))
    assert give(edge, "current", water) == []
    (estimate,) = edge.receive(Received("odometry", odometry(), b"", 29_000_000))
    assert (estimate.current.east_mps[0], estimate.current.north_mps[0]) == (0.3, -0.1)
    (estimate,) = edge.receive(Received("odometry", odometry(), b"", 31_000_000))
    assert estimate.current is None


def test_a_goal_is_a_point_and_a_route_is_waypoints_that_a_controller_can_read() -> None:
    edge = edge_with(speed_mps=0.7)
    goal = cdr.make("geometry_msgs/msg/PoseStamped", header=stamped(), pose=pose(3.0, 4.0, -5.0))
    (command,) = give(edge, "goal", goal)
    assert command.action is Action.FOLLOW
    point = read_reference(command)
    assert isinstance(point, references.Point)
    assert (point.north_m, point.east_m, point.depth_m) == (4.0, 3.0, 5.0)
    poses = [
        cdr.make("geometry_msgs/msg/PoseStamped", header=stamped(), pose=pose(x, 2.0 * x, -1.0)) for x in (0.0, 9.0)
    ]
    (command,) = give(edge, "route", cdr.make("nav_msgs/msg/Path", header=stamped(), poses=poses))
    route = read_reference(command)
    assert isinstance(route, references.Waypoints)
    assert route.speed_mps == 0.7
    assert [(place.north_m, place.east_m, place.depth_m) for place in route.waypoints] == [
        (0.0, 0.0, 1.0),
        (18.0, 9.0, 1.0),
    ]


@pytest.mark.parametrize(
    ("poses", "frame", "reason"), [(0, "map", "0 poses"), (501, "map", "501 poses"), (2, "map_ned", "must be ENU")]
)
def test_routes_that_cannot_be_followed_are_refused(poses: int, frame: str, reason: str) -> None:
    edge = edge_with()
    one = cdr.make("geometry_msgs/msg/PoseStamped", header=stamped(), pose=pose(1.0, 2.0, 0.0))
    assert give(edge, "route", cdr.make("nav_msgs/msg/Path", header=stamped(0.0, frame), poses=[one] * poses)) == []
    assert reason in edge.reason


def test_a_goal_that_the_controller_rejects_is_counted() -> None:
    edge = edge_with()
    goal = cdr.make("geometry_msgs/msg/PoseStamped", header=stamped(), pose=pose(3.0, 4.0, -5.0))
    (command,) = give(edge, "goal", goal)
    list(edge.take(acknowledged(command, accepted=False, why="outside the fence"), 0))
    assert "outside the fence" in edge.reason


def test_a_fence_comes_as_geojson_and_an_empty_text_removes_it() -> None:
    edge = edge_with()

    def of(text: str) -> list[Any]:
        return give(edge, "fence", cdr.make("std_msgs/msg/String", data=text))

    (command,) = of(SQUARE_FENCE)
    assert command.action is Action.FENCE
    fence = config.parse(config.loads(command.fence_toml), Fence, source="fence")
    assert (fence.margin_m, len(fence.keep_in)) == (2.0, 1)
    list(edge.take(acknowledged(command, accepted=False, why="the vehicle has no hull"), 0))
    assert edge.reason == "fence rejected: the vehicle has no hull"
    (command,) = of("")
    assert (command.action, command.fence_toml) == (Action.FENCE, "")
    assert edge.refused == 1
    for broken in ("{", "[]", SQUARE_FENCE.replace("keep_in", "keep_up"), SQUARE_FENCE.replace("50.3", '"x"')):
        assert of(broken) == []
    assert edge.refused == 5


OBSTACLES = """{"t_ns": 9, "obstacles": [{"id": 7, "t_ns": 8, "north_m": 40.0, "east_m": -15, "velocity_north_mps": 0.0,
"velocity_east_mps": 0.4, "radius_m": 4.0, "covariance_m2": [4.0, 1.0, 4.0]}]}"""


def test_obstacles_come_as_the_json_of_their_message() -> None:
    edge = edge_with()

    def of(text: str) -> list[Any]:
        return give(edge, "obstacles", cdr.make("std_msgs/msg/String", data=text))

    (message,) = of(OBSTACLES)
    (ship,) = message.obstacles
    assert (message.t_ns, ship.id, ship.t_ns, ship.north_m, ship.east_m) == (9, 7, 8, 40.0, -15.0)
    assert (ship.velocity_east_mps, ship.radius_m, ship.covariance_m2) == (0.4, 4.0, (4.0, 1.0, 4.0))
    for broken in ("", "{", "[]", "[" * 9999, OBSTACLES.replace("radius", "length"), OBSTACLES.replace("40.0", "4e9")):
        assert of(broken) == []
        assert edge.reason
    assert (edge.accepted, edge.refused) == (1, 6)


def acknowledged(command: Command, *, accepted: bool = True, why: str = "") -> Acknowledgement:
    return Acknowledgement(
        t_ns=0, command_id=command.command_id, accepted=accepted, authority=Authority.CONTROLLER, why=why
    )


@pytest.mark.parametrize(
    ("service", "data", "action"),
    [
        ("arm", True, Action.ARM),
        ("arm", False, Action.DISARM),
        ("hold", True, Action.HOLD),
        ("stop", None, Action.STOP),
        ("disarm", None, Action.DISARM),
        ("release", None, Action.RELEASE),
    ],
)
def test_a_service_is_a_command_and_its_reply_that_of_the_controller(
    service: str, data: bool | None, action: Action
) -> None:
    edge = edge_with()
    ros_type = BY_NAME[service].ros_type
    request = cdr.make(f"{ros_type}_Request", **({} if data is None else {"data": data}))
    (command,) = give(edge, f"{service}?7", request)
    assert command.action is action
    (reply,) = edge.take(acknowledged(command), 0)
    assert reply.channel == f"{service}?7"
    response = cdr.decode(reply.payload, f"{ros_type}_Response")
    assert (response.success, response.message) == (True, "controller")


def test_a_request_without_an_answer_or_a_meaning_or_with_broken_bytes_is_answered() -> None:
    edge = edge_with()
    on = cdr.make("std_srvs/srv/SetBool_Request", data=True)
    off = cdr.make("std_srvs/srv/SetBool_Request", data=False)
    (reply,) = give(edge, "hold?1", off)
    assert "has no meaning" in cdr.decode(reply.payload, "std_srvs/srv/SetBool_Response").message
    give(edge, "arm?2", on, now_us=0)
    assert list(edge.step(2_900_000)) == []
    (reply,) = edge.step(3_100_000)
    assert reply.channel == "arm?2"
    response = cdr.decode(reply.payload, "std_srvs/srv/SetBool_Response")
    assert (response.success, response.message) == (False, "no reply from the controller within 3 s")
    (reply,) = edge.receive(Received("arm?3", b"\0\1", b"", 0))
    assert not cdr.decode(reply.payload, "std_srvs/srv/SetBool_Response").success
    assert edge.refused == 1


def test_numbers_of_publishers_show_what_was_lost_and_what_comes_twice() -> None:
    edge = edge_with()
    for number in (1, 2, 5, 5):
        edge.receive(Received("odometry", odometry(), Attachment(number, 0, bytes(16)).pack(), 0))
    assert (edge.lost, edge.accepted, edge.refused, edge.reason) == (2, 3, 1, "duplicate")
    edge.receive(Received("odometry", odometry(), b"short", 0))
    assert edge.reason == "attachment: 5 bytes, must be 33"


# --- out -------------------------------------------------------------------------------------------------------------


def playing(**settings: Any) -> Ros2Edge:
    edge = edge_with(**settings)
    edge.receive(Received("odometry", odometry(), b"", 0))
    list(edge.take(plan(T_NS), 0))
    return edge


def test_thrusts_follow_the_plan_and_end_with_it() -> None:
    edge = playing()
    frames = list(edge.step(500_000))
    assert [read(frames, name).data for name in ("port", "starboard", "vertical")] == [5.0, -10.0, 2.5]
    wrench = read(frames, "wrench").wrench
    arm = PAPER.thruster.port.arm_m
    assert (wrench.force.x, wrench.force.z) == (-5.0, -2.5)
    assert wrench.torque.z == pytest.approx(
        -15.0 * arm
    )  # port ahead of starboard turns to starboard: about up, negative
    assert read(edge.step(2_100_000), "port").data == 0.0
    assert read(edge.release(0), "starboard").data == 0.0


def test_what_acts_are_the_thrusts_it_forwards_and_zero_past_the_end_of_the_plan() -> None:
    edge = edge_with()
    edge.receive(Received("odometry", odometry(), b"", 0))
    list(edge.take(plan(T_NS), 100_000, (7, 3)))

    def applied(now_us: int) -> Applied:
        (report,) = (output for output in edge.step(now_us) if isinstance(output, Applied))
        return report

    driving = applied(500_000)
    assert driving.command_N == (5.0, -10.0, 2.5)
    assert (driving.t_ns, driving.plan_epoch, driving.plan_sequence) == (T_NS + 500_000_000, 7, 3)
    assert (driving.plan_received_t_ns, driving.plan_late) == (T_NS + 100_000_000, True)
    assert 0.0 < applied(700_000).thrust_N[0] < 7.0  # behind the command, by the lag
    assert not any(isinstance(output, Applied) for output in edge.step(750_000))
    ended = applied(2_100_000)
    assert (ended.command_N, ended.health) == ((0.0, 0.0, 0.0), Health.FAILSAFE)


def test_one_array_has_the_thrusts_in_the_order_and_scale_that_are_set() -> None:
    frames = list(playing(array="starboard,port", scale=0.1).step(500_000))
    array = read(frames, "thrusts")
    assert array.data.tolist() == [-1.0, 0.5]
    assert array.layout.dim[0].label == "starboard,port"
    assert {frame.channel for frame in frames if isinstance(frame, Outgoing)} == {"thrusts", "wrench"}


def test_the_predicted_path_is_in_enu() -> None:
    edge = edge_with()
    path = read(edge.take(plan(T_NS), 0), "path")
    assert [(p.pose.position.x, p.pose.position.y) for p in path.poses] == [(2.0, 1.0)] * 3
    turn = path.poses[0].pose.orientation
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(math.pi / 2 - 0.5)
    assert path.poses[1].header.stamp.sec == path.poses[0].header.stamp.sec + 1


def test_the_status_of_controller_and_edge_is_diagnostics() -> None:
    edge = edge_with()
    edge.refuse(Refused("no odometry: x"))
    controller, own = read(edge.take(status(), 0), "diagnostics").status
    assert (controller.level, controller.message) == (2, "no estimate")
    assert (own.level, own.values[0].key, own.values[0].value) == (1, "no odometry", "1")


@pytest.mark.parametrize(
    ("report", "level", "text"),
    [
        (FenceReport(clearance_m=3.0, nearest="pier"), 0, "outside all margins"),
        (
            FenceReport(clearance_m=3.0, time_to_zone_ns=20 * SECOND_NS),
            1,
            "the hull will be in a zone or obstacle in 20 s",
        ),
        (FenceReport(clearance_m=1.0, in_margin=("pier", "buoy")), 1, "in a margin: pier, buoy"),
        (FenceReport(clearance_m=-1.0, in_margin=("pier", "buoy"), inside=("pier",)), 2, "in a zone: pier"),
    ],
)
def test_the_fence_of_the_newest_plan_is_in_the_diagnostics(report: FenceReport, level: int, text: str) -> None:
    edge = edge_with()
    list(edge.take(msgspec.structs.replace(plan(T_NS), fence=report), 0))
    row = read(edge.take(status(), 0), "diagnostics").status[-1]
    assert (row.name, row.level, row.message) == ("ltv_mpc: fence", level, text)
    assert {pair.key: pair.value for pair in row.values} == {
        "nearest": report.nearest,
        "clearance_m": str(report.clearance_m),
        "inside": ", ".join(report.inside),
        "in_margin": ", ".join(report.in_margin),
        "time_to_zone_ns": str(report.time_to_zone_ns),
    }
    list(edge.take(plan(T_NS), 0))
    assert len(read(edge.take(status(), 0), "diagnostics").status) == 2


def test_the_fence_in_force_is_markers_in_enu() -> None:
    (fence,) = (message for message in EXAMPLES if isinstance(message, FenceInForce))
    (zone,), (ship,) = fence.zones, fence.obstacles
    disc = msgspec.structs.replace(zone, label="buoy", vertices_m=np.array([[3.0, 4.0]]), radius_m=2.0)
    later = msgspec.structs.replace(fence, t_ns=ship.t_ns + 10 * SECOND_NS, zones=(zone, disc))
    clear, line, buoy, obstacle = read(edge_with().take(later, 0), "zones").markers
    assert (clear.action, line.action) == (clear.DELETEALL, line.ADD)
    assert (line.type, line.text) == (line.LINE_STRIP, zone.label)
    assert [(p.y, p.x) for p in line.points] == [*map(tuple, zone.vertices_m.tolist()), tuple(zone.vertices_m[0])]
    assert (buoy.type, buoy.pose.position.y, buoy.pose.position.x, buoy.scale.x) == (buoy.CYLINDER, 3.0, 4.0, 4.0)
    assert (obstacle.type, obstacle.text, obstacle.scale.y) == (obstacle.CYLINDER, "obstacle 12", 2.0 * ship.radius_m)
    assert (obstacle.pose.position.y, obstacle.pose.position.x) == (ship.north_m + 10.0, ship.east_m)
    assert len({(marker.ns, marker.id) for marker in (line, buoy, obstacle)}) == 3
    assert all(marker.color.a == 1.0 for marker in (line, buoy, obstacle))


def test_the_water_is_a_cloud_once_a_second() -> None:
    profile = CurrentProfile(
        depth_m=np.array([0.0, 10.0]), north_mps=np.array([0.1, 0.2]), east_mps=np.array([0.3, 0.4])
    )
    estimate = msgspec.structs.replace(Estimate.at_rest(north_m=1.0, east_m=2.0), t_ns=T_NS, current=profile)
    edge = edge_with()
    cloud = read(edge.take(estimate, 2_000_000), "water")
    points = cloud.data.view("<f4").reshape(cloud.width, -1)
    np.testing.assert_allclose(points[:, :5], [[2, 1, 0, 0.3, 0.1], [2, 1, -10, 0.4, 0.2]])
    assert np.isnan(points[:, 5]).all()
    assert list(edge.take(estimate, 2_900_000)) == []


def test_the_transform_leads_from_the_reference_point_to_the_origin() -> None:
    vehicle = msgspec.structs.replace(
        PAPER, reference_point=ReferencePoint(forward_m=0.5, starboard_m=0.2, down_m=-0.1)
    )
    (transform,) = read(Ros2Edge(1, Settings(vehicle=vehicle)).start(), "tf_static").transforms
    at = transform.transform.translation
    assert (transform.header.frame_id, transform.child_frame_id) == ("base_link", "base_link_origin")
    assert (at.x, at.y, at.z) == (-0.5, 0.2, -0.1)
