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
from services.edges.ros2.conversions import Settings, header
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
    return Ros2Edge(1, Settings(**({"vehicle": PAPER} | settings)))


def give(
    edge: Ros2Edge, name: str, at_s: float = 0.0, frame: str = "odom", request: str = "", **fields: Any
) -> list[Any]:
    """Pass a message on a topic, or a request of a service, and return the outputs."""
    ros_type = BY_NAME[name].ros_type
    if request:
        return edge.receive(
            Received(f"{name}?{request}", cdr.encode(cdr.make(f"{ros_type}_Request", **fields)), b"", 0)
        )
    if ros_type != "std_msgs/msg/String":
        fields["header"] = header(T_NS + round(at_s * 1e9), frame)
    return edge.receive(Received(name, cdr.encode(cdr.make(ros_type, **fields)), b"", 0))


def on_odometry(edge: Ros2Edge, now_us: int = 0, attachment: bytes = b"") -> list[Any]:
    return edge.receive(Received("odometry", odometry(), attachment, now_us))


def pose(x: float, y: float, z: float, yaw: float = 0.0) -> dict[str, Any]:
    turn = {"z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    return {"position": {"x": x, "y": y, "z": z}, "orientation": turn}


def poses(*places: tuple[float, float, float]) -> list[dict[str, Any]]:
    return [{"pose": pose(*place)} for place in places]


def reference_of(command: Command) -> Any:
    """Read the reference of a command as the controller does."""
    return config.parse(config.loads(command.reference_toml), references.Reference, source="reference")  # type: ignore[arg-type]


def read(frames: Any, name: str) -> Any:
    (payload,) = (frame.payload for frame in frames if isinstance(frame, Outgoing) and frame.channel == name)
    return cdr.decode(payload, BY_NAME[name].ros_type)


def acknowledged(command: Command, *, accepted: bool = True, why: str = "") -> Acknowledgement:
    return Acknowledgement(
        t_ns=0, command_id=command.command_id, accepted=accepted, authority=Authority.CONTROLLER, why=why
    )


# --- in --------------------------------------------------------------------------------------------------------------


def test_a_pose_and_its_twist_are_an_estimate_but_not_beside_odometry() -> None:
    edge = edge_with()
    there, ahead = {"pose": pose(3.0, 4.0, -5.0, math.pi / 2)}, {"twist": {"linear": {"x": 1.0}}}
    assert give(edge, "pose", pose=there) == []  # without a twist it is refused
    assert give(edge, "twist", -0.1, "base_link", twist=ahead) == []
    (estimate,) = give(edge, "pose", pose=there)
    assert (estimate.north_m, estimate.east_m, estimate.depth_m, estimate.t_ns) == (4.0, 3.0, 5.0, T_NS)
    assert estimate.velocity_north_mps == pytest.approx(1.0)
    assert give(edge, "pose", 0.2, pose=there) == []  # the twist is 0.3 s old
    assert edge.refused == 2
    on_odometry(edge)
    assert give(edge, "pose", pose=there) == []
    assert edge.reason == "pose: the odometry is in use"


def test_the_current_is_added_to_the_estimates_for_thirty_seconds() -> None:
    edge = edge_with()
    assert give(edge, "current", twist={"linear": {"x": 0.3, "y": -0.1}}) == []
    (estimate,) = on_odometry(edge, 29_000_000)
    assert (estimate.current.east_mps[0], estimate.current.north_mps[0]) == (0.3, -0.1)
    (estimate,) = on_odometry(edge, 31_000_000)
    assert estimate.current is None


def test_a_goal_is_a_point_and_a_route_is_waypoints_that_a_controller_can_read() -> None:
    edge = edge_with(speed_mps=0.7)
    (command,) = give(edge, "goal", pose=pose(3.0, 4.0, -5.0))
    assert command.action is Action.FOLLOW
    assert reference_of(command) == references.Point(north_m=4.0, east_m=3.0, depth_m=5.0)
    list(edge.take(acknowledged(command, accepted=False, why="outside the fence"), 0))
    assert edge.reason == "goal rejected: outside the fence"
    (command,) = give(edge, "route", poses=poses((0.0, 0.0, -1.0), (9.0, 18.0, -1.0)))
    route = reference_of(command)
    assert route.speed_mps == 0.7
    assert [(place.north_m, place.east_m, place.depth_m) for place in route.waypoints] == [(0, 0, 1), (18, 9, 1)]


@pytest.mark.parametrize(
    ("count", "frame", "reason"), [(0, "map", "0 poses"), (501, "map", "501 poses"), (2, "map_ned", "must be ENU")]
)
def test_routes_that_cannot_be_followed_are_refused(count: int, frame: str, reason: str) -> None:
    edge = edge_with()
    assert give(edge, "route", frame=frame, poses=poses((1.0, 2.0, 0.0)) * count) == []
    assert reason in edge.reason


def test_a_fence_comes_as_geojson_and_an_empty_text_removes_it() -> None:
    edge = edge_with()
    (command,) = give(edge, "fence", data=SQUARE_FENCE)
    fence = config.parse(config.loads(command.fence_toml), Fence, source="fence")
    assert (command.action, fence.margin_m, len(fence.keep_in)) == (Action.FENCE, 2.0, 1)
    list(edge.take(acknowledged(command, accepted=False, why="the vehicle has no hull"), 0))
    assert edge.reason == "fence rejected: the vehicle has no hull"
    (command,) = give(edge, "fence", data="")
    assert (command.action, command.fence_toml, edge.refused) == (Action.FENCE, "", 1)
    for broken in ("{", "[]", SQUARE_FENCE.replace("keep_in", "keep_up"), SQUARE_FENCE.replace("50.3", '"x"')):
        assert give(edge, "fence", data=broken) == []
    assert edge.refused == 5


OBSTACLES = """{"t_ns": 9, "obstacles": [{"id": 7, "t_ns": 8, "north_m": 40.0, "east_m": -15, "velocity_north_mps": 0.0,
"velocity_east_mps": 0.4, "radius_m": 4.0, "covariance_m2": [4.0, 1.0, 4.0]}]}"""


def test_obstacles_come_as_the_json_of_their_message() -> None:
    edge = edge_with()
    (message,) = give(edge, "obstacles", data=OBSTACLES)
    (ship,) = message.obstacles
    assert (message.t_ns, ship.id, ship.t_ns, ship.north_m, ship.east_m) == (9, 7, 8, 40.0, -15.0)
    assert (ship.velocity_east_mps, ship.radius_m, ship.covariance_m2) == (0.4, 4.0, (4.0, 1.0, 4.0))
    for broken in ("", "{", "[]", "[" * 9999, OBSTACLES.replace("radius", "length"), OBSTACLES.replace("40.0", "4e9")):
        assert give(edge, "obstacles", data=broken) == []
    assert (edge.accepted, edge.refused) == (1, 6)


@pytest.mark.parametrize(
    ("service", "fields", "action"),
    [
        ("arm", {"data": True}, Action.ARM),
        ("arm", {"data": False}, Action.DISARM),
        ("hold", {"data": True}, Action.HOLD),
        ("stop", {}, Action.STOP),
        ("disarm", {}, Action.DISARM),
        ("release", {}, Action.RELEASE),
    ],
)
def test_a_service_is_a_command_and_its_reply_that_of_the_controller(service, fields, action) -> None:
    edge = edge_with()
    (command,) = give(edge, service, request="7", **fields)
    assert command.action is action
    (reply,) = edge.take(acknowledged(command), 0)
    assert reply.channel == f"{service}?7"
    response = cdr.decode(reply.payload, f"{BY_NAME[service].ros_type}_Response")
    assert (response.success, response.message) == (True, "controller")


def test_a_request_without_an_answer_or_a_meaning_or_with_broken_bytes_is_answered() -> None:
    edge = edge_with()

    def answer(replies: Any) -> tuple[str, bool, str]:
        (reply,) = replies
        response = cdr.decode(reply.payload, "std_srvs/srv/SetBool_Response")
        return reply.channel, response.success, response.message

    assert "has no meaning" in answer(give(edge, "hold", request="1", data=False))[2]
    give(edge, "arm", request="2", data=True)
    assert list(edge.step(2_900_000)) == []
    assert answer(edge.step(3_100_000)) == ("arm?2", False, "no reply from the controller within 3 s")
    assert not answer(edge.receive(Received("arm?3", b"\0\1", b"", 0)))[1]
    assert edge.refused == 1


def test_numbers_of_publishers_show_what_was_lost_and_what_comes_twice() -> None:
    edge = edge_with()
    for number in (1, 2, 5, 5):
        on_odometry(edge, attachment=Attachment(number, 0, bytes(16)).pack())
    assert (edge.lost, edge.accepted, edge.refused, edge.reason) == (2, 3, 1, "duplicate")
    on_odometry(edge, attachment=b"short")
    assert edge.reason == "attachment: 5 bytes, must be 33"


# --- out -------------------------------------------------------------------------------------------------------------


def playing(**settings: Any) -> Ros2Edge:
    edge = edge_with(**settings)
    on_odometry(edge)
    list(edge.take(plan(T_NS), 100_000, (7, 3)))
    return edge


def test_thrusts_and_what_acts_follow_the_plan_and_end_with_it() -> None:
    edge = playing()
    frames = list(edge.step(500_000))
    assert [read(frames, name).data for name in ("port", "starboard", "vertical")] == [5.0, -10.0, 2.5]
    wrench = read(frames, "wrench").wrench
    assert (wrench.force.x, wrench.force.z) == (-5.0, -2.5)
    # port ahead of starboard turns to starboard: about up, negative
    assert wrench.torque.z == pytest.approx(-15.0 * PAPER.thruster.port.arm_m)

    def applied(frames: Any) -> Applied:
        (report,) = (output for output in frames if isinstance(output, Applied))
        return report

    driving = applied(frames)
    assert driving.command_N == (5.0, -10.0, 2.5)
    assert (driving.t_ns, driving.plan_epoch, driving.plan_sequence) == (T_NS + 500_000_000, 7, 3)
    assert (driving.plan_received_t_ns, driving.plan_late) == (T_NS + 100_000_000, True)
    assert 0.0 < applied(edge.step(700_000)).thrust_N[0] < 7.0  # behind the command, by the lag
    assert not any(isinstance(output, Applied) for output in edge.step(750_000))
    frames = list(edge.step(2_100_000))
    assert (applied(frames).command_N, applied(frames).health) == ((0.0, 0.0, 0.0), Health.FAILSAFE)
    assert read(frames, "port").data == 0.0
    assert read(playing().release(0), "starboard").data == 0.0


def test_one_array_has_the_thrusts_in_the_order_and_scale_that_are_set() -> None:
    frames = list(playing(array="starboard,port", scale=0.1).step(500_000))
    array = read(frames, "thrusts")
    assert array.data.tolist() == [-1.0, 0.5]
    assert array.layout.dim[0].label == "starboard,port"
    assert {frame.channel for frame in frames if isinstance(frame, Outgoing)} == {"thrusts", "wrench"}


def test_the_predicted_path_is_in_enu() -> None:
    path = read(edge_with().take(plan(T_NS), 0), "path")
    assert [(p.pose.position.x, p.pose.position.y) for p in path.poses] == [(2.0, 1.0)] * 3
    turn = path.poses[0].pose.orientation
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(math.pi / 2 - 0.5)
    assert path.poses[1].header.stamp.sec == path.header.stamp.sec + 1


@pytest.mark.parametrize(
    ("report", "level", "text"),
    [
        ({"clearance_m": 3.0, "nearest": "pier"}, 0, "outside all margins"),
        ({"clearance_m": 3.0, "time_to_zone_ns": 20 * SECOND_NS}, 1, "the hull will be in a zone or obstacle in 20 s"),
        ({"clearance_m": 1.0, "in_margin": ("pier", "buoy")}, 1, "in a margin: pier, buoy"),
        ({"clearance_m": -1.0, "in_margin": ("pier", "buoy"), "inside": ("pier",)}, 2, "in a zone: pier"),
    ],
)
def test_the_status_of_controller_edge_and_fence_is_diagnostics(report: dict[str, Any], level: int, text: str) -> None:
    edge, fence = edge_with(), FenceReport(**report)
    edge.refuse(Refused("no odometry: x"))
    list(edge.take(msgspec.structs.replace(plan(T_NS), fence=fence), 0))
    controller, own, row = read(edge.take(status(), 0), "diagnostics").status
    assert (controller.level, controller.message) == (2, "no estimate")
    assert {pair.key: pair.value for pair in controller.values}["authority"] == "disarmed"
    assert (own.level, own.values[0].key, own.values[0].value) == (1, "no odometry", "1")
    assert (row.name, row.level, row.message) == ("ltv_mpc: fence", level, text)
    assert {pair.key: pair.value for pair in row.values} == {
        "nearest": fence.nearest,
        "clearance_m": str(fence.clearance_m),
        "inside": ", ".join(fence.inside),
        "in_margin": ", ".join(fence.in_margin),
        "time_to_zone_ns": str(fence.time_to_zone_ns),
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
    assert all(marker.color.a == marker.pose.orientation.w == 1.0 for marker in (line, buoy, obstacle))


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
    at = ReferencePoint(forward_m=0.5, starboard_m=0.2, down_m=-0.1)
    edge = edge_with(vehicle=msgspec.structs.replace(PAPER, reference_point=at))
    (transform,) = read(edge.start(), "tf_static").transforms
    to = transform.transform.translation
    assert (transform.header.frame_id, transform.child_frame_id) == ("base_link", "base_link_origin")
    assert (to.x, to.y, to.z, transform.transform.rotation.w) == (-0.5, 0.2, -0.1, 1.0)
