"""Conversion of the other ROS 2 messages: commands and water in; thrusts, plan, status and water out.

ENU and FLU (REP 103) there, NED and FRD here: x = east, y = north, z = -depth, yaw = pi/2 - heading, and about the
body's upward axis the moments of thrusters are negative. Stamps are vehicle time, whose clock the odometry sets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np

from ltv_mpc.config import to_toml
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.obstacles import predicted_m
from ltv_mpc.messages import (
    Array,
    ControllerStatus,
    CurrentProfile,
    Estimate,
    FenceInForce,
    FenceReport,
    Health,
    Obstacles,
    Plan,
)
from ltv_mpc.validation import rejection_reason
from ltv_mpc.vehicle.parameters import Vehicle
from services.edges.edge import Refused
from services.edges.ros2.cdr import make
from services.edges.ros2.odometry import check_frames, stamp_ns, vector

MAX_POSES = 500
"""Longest path: a reference has at most 64 KiB."""

PAIR_NS = 200_000_000
"""Largest time between a pose and the twist that makes an estimate with it."""

MILLION = 1_000_000_000

FRAME, CHILD_FRAME = "odom", "base_link"


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of the edge to ROS 2."""

    vehicle: Vehicle
    speed_mps: float = 0.5  # on a path, which has no speed of its own
    array: str = ""  # order of one Float64MultiArray, such as "port,starboard"; empty: a Float64 for each thruster
    scale: float = 1.0  # of that array, per N


# --- in --------------------------------------------------------------------------------------------------------------


def odometry_of(pose: Any, twist: Any) -> Any:
    """Return odometry of a PoseWithCovarianceStamped and the TwistWithCovarianceStamped nearest to it."""
    if twist is None or abs(stamp_ns(pose.header) - stamp_ns(twist.header)) > PAIR_NS:
        raise Refused("pose without a twist: none within 0.2 s of its stamp")
    return SimpleNamespace(header=pose.header, child_frame_id=twist.header.frame_id, pose=pose.pose, twist=twist.twist)


def current_of(message: Any) -> CurrentProfile:
    """Return the velocity of the water over ground of a TwistStamped in ENU, the same at all depths."""
    check_frames(message.header.frame_id)
    east, north, _ = vector("linear", message.twist.linear)
    profile = CurrentProfile(depth_m=np.array([0.0]), north_mps=np.array([north]), east_mps=np.array([east]))
    if (reason := rejection_reason(profile)) is not None:
        raise Refused(f"current: {reason}")  # it would exclude the estimates of the next 30 s
    return profile


def reference_of(poses: Sequence[Any], header: Any, settings: Settings) -> str:
    """Return the reference file of a path, or of a point if it has one pose."""
    check_frames(header.frame_id)
    if not 1 <= len(poses) <= MAX_POSES:
        raise Refused(f"path: {len(poses)} poses, must be 1 to {MAX_POSES}")
    places = [_place(vector("position", pose.position), settings) for pose in poses]
    if len(places) == 1:
        return to_toml({"kind": "point", **places[0]})
    return to_toml({"kind": "waypoints", "speed_mps": settings.speed_mps, "waypoints": places})


def fence_of(text: str) -> str:
    """Return the fence file of a GeoJSON text; empty for an empty text, which removes the fence."""
    try:
        return to_toml(Fence.from_geojson(text, "fence")) if text else ""
    except ConfigError as error:
        raise Refused(str(error)) from None


def obstacles_of(text: str) -> Obstacles:
    """Return the message of a JSON text with its fields. Raises ``Refused``."""
    try:
        return msgspec.json.decode(text, type=Obstacles)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise Refused(f"obstacles: {error}") from None


def _place(position: Array, settings: Settings) -> dict[str, float]:
    place = {"north_m": float(position[1]), "east_m": float(position[0])}
    return place | ({"depth_m": max(float(-position[2]), 0.0)} if settings.vehicle.can_dive else {})


# --- out -------------------------------------------------------------------------------------------------------------


def header(t_ns: int, frame: str) -> dict[str, Any]:
    """Return a std_msgs/Header. Raises ``Refused`` for a time beyond the seconds of ROS 2, which have 32 bits."""
    sec, nanosec = divmod(t_ns, MILLION)
    if not -(2**31) <= sec < 2**31:
        raise Refused(f"time = {sec} s: ROS 2 has no such stamp")
    return {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame}


def thrust_messages(thrust_N: Array, t_ns: int, settings: Settings) -> dict[str, Any]:
    """Return the messages of a thrust (3,) in N by the name of their topics."""
    port, starboard, vertical = (float(force) for force in thrust_N)
    named = {"port": port, "starboard": starboard, "vertical": vertical}
    of = settings.vehicle.thruster
    if settings.array:
        data = np.array([named[name] * settings.scale for name in settings.array.split(",")])
        layout = {"dim": [{"label": settings.array, "size": len(data), "stride": len(data)}]}
        messages = {"thrusts": make("std_msgs/msg/Float64MultiArray", layout=layout, data=data)}
    else:
        messages = {name: make("std_msgs/msg/Float64", data=force) for name, force in named.items()}
    wrench = {
        "force": {"x": port + starboard, "z": -vertical},
        "torque": {"z": of.starboard.arm_m * starboard - of.port.arm_m * port},
    }
    stamped = make("geometry_msgs/msg/WrenchStamped", header=header(t_ns, CHILD_FRAME), wrench=wrench)
    return messages | {"wrench": stamped}


def path_of(plan: Plan) -> Any:
    """Return the predicted positions and headings of a plan as nav_msgs/Path, at the depth 0."""
    yaw, places = 0.5 * (math.pi / 2.0 - plan.states[:, 4]), plan.states[:, :2].tolist()
    turns = zip(np.sin(yaw).tolist(), np.cos(yaw).tolist(), strict=True)
    poses = [
        {"header": header(t_ns, FRAME), "pose": _pose(north_m, east_m, z, w)}
        for t_ns, (north_m, east_m), (z, w) in zip(plan.t_ns.tolist(), places, turns, strict=True)
    ]
    return make("nav_msgs/msg/Path", header=poses[0]["header"], poses=poses)


LEVELS = {Health.NOMINAL: 0, Health.DEGRADED: 1, Health.HOLD: 1, Health.FAILSAFE: 2}
"""Level of a DiagnosticStatus (OK, WARN, ERROR) of each health."""

OF_CONTROLLER = ("authority", "error_m", "progress", "arrived", "cycle_p99_us", "estimate_age_ns", "mission_action",
                 "dropped")  # fmt: skip
"""Fields of a ``ControllerStatus`` among the diagnostics."""


def diagnostics_of(
    status: ControllerStatus, fence: FenceReport | None, refused: dict[str, int], t_ns: int, settings: Settings
) -> Any:
    """Return the status of controller, fence and this edge as diagnostic_msgs/DiagnosticArray."""
    why = status.health_why or status.health.value
    rows: list[tuple[str, int, str, dict[str, Any]]] = [
        ("controller", LEVELS[status.health], why, {name: getattr(status, name) for name in OF_CONTROLLER}),
        ("ros2", 1 if refused else 0, "frames refused" if refused else "no frame refused", {**refused}),
    ]
    if fence is not None:
        values = {name: getattr(fence, name) for name in ("nearest", "clearance_m", "time_to_zone_ns")}
        zones = {"inside": ", ".join(fence.inside), "in_margin": ", ".join(fence.in_margin)}
        rows.append(("fence", *_of_fence(fence, zones), values | zones))
    diagnostics = [
        {
            "level": level,
            "name": f"ltv_mpc: {name}",
            "message": text,
            "hardware_id": settings.vehicle.name,
            "values": [{"key": key, "value": str(value)} for key, value in values.items()],
        }
        for name, level, text, values in rows
    ]
    return make("diagnostic_msgs/msg/DiagnosticArray", header=header(t_ns, ""), status=diagnostics)


def _of_fence(fence: FenceReport, zones: dict[str, str]) -> tuple[int, str]:
    """Return level and text: an error inside a zone, a warning in a margin or if a zone lies ahead."""
    if zones["inside"]:
        return 2, f"in a zone: {zones['inside']}"
    if zones["in_margin"]:
        return 1, f"in a margin: {zones['in_margin']}"
    if fence.time_to_zone_ns is not None:
        return 1, f"the hull will be in a zone or obstacle in {fence.time_to_zone_ns * 1e-9:.0f} s"
    return 0, "outside all margins"


CURRENT_FIELDS = ("x", "y", "z", "east_mps", "north_mps", "sd_mps")


def cloud_of(estimate: Estimate, profile: CurrentProfile) -> Any:
    """Return the velocity of the water below the vehicle as PointCloud2, a point for each depth."""
    points = np.full((len(profile.depth_m), len(CURRENT_FIELDS)), np.nan, dtype="<f4")
    points[:, 0], points[:, 1], points[:, 2] = estimate.east_m, estimate.north_m, -profile.depth_m
    points[:, 3], points[:, 4] = profile.east_mps, profile.north_mps
    if profile.sd_mps is not None:
        points[:, 5] = profile.sd_mps
    fields = [{"name": name, "offset": 4 * at, "datatype": 7, "count": 1} for at, name in enumerate(CURRENT_FIELDS)]
    return make(
        "sensor_msgs/msg/PointCloud2",
        header=header(estimate.t_ns, FRAME),
        height=1,
        width=len(points),
        fields=fields,
        point_step=points.strides[0],
        row_step=points.nbytes,
        data=np.frombuffer(points.tobytes(), dtype=np.uint8),
        is_dense=profile.sd_mps is not None,
    )


CYLINDER, LINE_STRIP, DELETE_ALL = 3, 4, 3
"""Numbers of visualization_msgs/Marker."""

LINE_M = 0.2
"""Width of a line, and height of a cylinder."""

KEEP_IN, KEEP_OUT, OBSTACLE = (
    dict(zip("rgba", colour, strict=True))
    for colour in ((0.0, 0.45, 0.7, 1.0), (0.55, 0.11, 0.09, 1.0), (0.63, 0.32, 0.18, 1.0))
)
"""Colours: red, green, blue, opacity."""


def zones_of(fence: FenceInForce) -> Any:
    """Return zones and obstacles as visualization_msgs/MarkerArray; its first marker removes those of the array before.

    An obstacle is where it is predicted at the time of the message. The text of a marker is the label of its zone.
    """
    markers: list[dict[str, Any]] = [{"action": DELETE_ALL}]
    for zone in fence.zones:
        ring = zone.vertices_m.tolist()
        shape = _cylinder(ring[0], zone.radius_m) if zone.radius_m > 0.0 else _line([*ring, ring[0]])
        markers.append(shape | {"ns": "zones", "text": zone.label, "color": KEEP_IN if zone.keep_in else KEEP_OUT})
    for obstacle in fence.obstacles:
        shape = _cylinder(predicted_m(obstacle, fence.t_ns), obstacle.radius_m)
        markers.append(shape | {"ns": "obstacles", "text": f"obstacle {obstacle.id}", "color": OBSTACLE})
    for at, marker in enumerate(markers):
        marker |= {"id": at, "header": header(fence.t_ns, FRAME)}
    return make("visualization_msgs/msg/MarkerArray", markers=markers)


def _pose(north_m: float, east_m: float, z: float = 0.0, w: float = 1.0) -> dict[str, Any]:
    return {"position": {"x": east_m, "y": north_m}, "orientation": {"z": z, "w": w}}


def _cylinder(place_m: Sequence[float], radius_m: float) -> dict[str, Any]:
    return {"type": CYLINDER, "pose": _pose(*place_m), "scale": {"x": 2.0 * radius_m, "y": 2.0 * radius_m, "z": LINE_M}}


def _line(places_m: list[list[float]]) -> dict[str, Any]:
    points = [{"x": east_m, "y": north_m} for north_m, east_m in places_m]
    return {"type": LINE_STRIP, "points": points, "pose": {"orientation": {"w": 1.0}}, "scale": {"x": LINE_M}}


def reference_point_of(settings: Settings) -> Any:
    """Return the static transform from the reference point, which the odometry gives, to the vehicle's origin."""
    at = settings.vehicle.reference_point
    stamped = {
        "header": header(0, CHILD_FRAME),
        "child_frame_id": f"{CHILD_FRAME}_origin",
        "transform": {"translation": {"x": -at.forward_m, "y": at.starboard_m, "z": at.down_m}, "rotation": {"w": 1.0}},
    }
    return make("tf2_msgs/msg/TFMessage", transforms=[stamped])
