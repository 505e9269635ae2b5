"""Fence in force as markers of a display: a line along each polygon, a flat cylinder for each disc and obstacle."""

from __future__ import annotations

from typing import Any

import numpy as np

from ltv_mpc.geofence.obstacles import predicted_m
from ltv_mpc.messages import FenceInForce
from services.edges.ros2.cdr import make
from services.edges.ros2.conversions import Settings, header

CYLINDER, LINE_STRIP, ADD, DELETE_ALL = 3, 4, 0, 3
"""Numbers of visualization_msgs/Marker."""

LINE_M = 0.2
"""Width of a line, and height of a cylinder."""

KEEP_IN, KEEP_OUT, OBSTACLE = (0.0, 0.45, 0.7, 1.0), (0.55, 0.11, 0.09, 1.0), (0.63, 0.32, 0.18, 1.0)
"""Colours: red, green, blue, opacity."""


def zones_of(fence: FenceInForce, settings: Settings) -> Any:
    """Return zones and obstacles as visualization_msgs/MarkerArray; its first marker removes those of the array before.

    An obstacle is where it is predicted at the time of the message. The text of a marker is the label of its zone.
    """
    markers = [_marker(fence, settings, action=DELETE_ALL)]
    for zone in fence.zones:
        colour = KEEP_IN if zone.keep_in else KEEP_OUT
        of: dict[str, Any] = {"ns": "zones", "id": len(markers), "text": zone.label, "color": colour}
        if zone.radius_m > 0.0:
            north_m, east_m = zone.vertices_m[0].tolist()
            markers.append(_cylinder(fence, settings, north_m, east_m, zone.radius_m, **of))
        else:
            ring = [_point(north, east) for north, east in [*zone.vertices_m.tolist(), zone.vertices_m[0].tolist()]]
            markers.append(_marker(fence, settings, type=LINE_STRIP, scale=(LINE_M, 0.0, 0.0), points=ring, **of))
    for obstacle in fence.obstacles:
        north_m, east_m = predicted_m(obstacle, fence.t_ns)
        of = {"ns": "obstacles", "id": len(markers), "text": f"obstacle {obstacle.id}", "color": OBSTACLE}
        markers.append(_cylinder(fence, settings, north_m, east_m, obstacle.radius_m, **of))
    return make("visualization_msgs/msg/MarkerArray", markers=markers)


def _cylinder(
    fence: FenceInForce, settings: Settings, north_m: float, east_m: float, radius_m: float, **of: Any
) -> Any:
    scale = 2.0 * radius_m, 2.0 * radius_m, LINE_M
    return _marker(fence, settings, type=CYLINDER, scale=scale, position=_point(north_m, east_m), **of)


def _marker(fence: FenceInForce, settings: Settings, **of: Any) -> Any:
    """Return a marker in the frame of the odometry, with zeros for the fields that are not in ``of``."""
    red, green, blue, opacity = of.pop("color", (0.0, 0.0, 0.0, 0.0))
    x, y, z = of.pop("scale", (0.0, 0.0, 0.0))
    position = of.pop("position", None) or _point(0.0, 0.0)
    level = make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    nothing = np.empty(0, dtype=np.uint8)
    return make(
        "visualization_msgs/msg/Marker",
        header=header(fence.t_ns, settings.frame),
        pose=make("geometry_msgs/msg/Pose", position=position, orientation=level),
        scale=make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
        color=make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=opacity),
        lifetime=make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        colors=[],
        texture_resource="",
        texture=make("sensor_msgs/msg/CompressedImage", header=header(0, ""), format="", data=nothing),
        uv_coordinates=[],
        mesh_resource="",
        mesh_file=make("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
        **({"ns": "", "id": 0, "type": 0, "action": ADD, "points": [], "text": ""} | of),
    )


def _point(north_m: float, east_m: float) -> Any:
    return make("geometry_msgs/msg/Point", x=east_m, y=north_m, z=0.0)
