"""Fence in force as markers of a display: a line along each polygon, a flat cylinder for each disc and obstacle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ltv_mpc.geofence.obstacles import predicted_m
from ltv_mpc.messages import FenceInForce
from services.edges.ros2.cdr import make
from services.edges.ros2.conversions import Settings, header

CYLINDER, LINE_STRIP, DELETE_ALL = 3, 4, 3
"""Numbers of visualization_msgs/Marker."""

LINE_M = 0.2
"""Width of a line, and height of a cylinder."""

KEEP_IN, KEEP_OUT, OBSTACLE = (
    dict(zip("rgba", colour, strict=True))
    for colour in ((0.0, 0.45, 0.7, 1.0), (0.55, 0.11, 0.09, 1.0), (0.63, 0.32, 0.18, 1.0))
)
"""Colours: red, green, blue, opacity."""


def zones_of(fence: FenceInForce, settings: Settings) -> Any:
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
        marker |= {"id": at, "header": header(fence.t_ns, settings.frame)}
    return make("visualization_msgs/msg/MarkerArray", markers=markers)


def _cylinder(place_m: Sequence[float], radius_m: float) -> dict[str, Any]:
    north_m, east_m = place_m
    pose = {"position": {"x": east_m, "y": north_m}, "orientation": {"w": 1.0}}
    return {"type": CYLINDER, "pose": pose, "scale": {"x": 2.0 * radius_m, "y": 2.0 * radius_m, "z": LINE_M}}


def _line(places_m: list[list[float]]) -> dict[str, Any]:
    points = [{"x": east_m, "y": north_m} for north_m, east_m in places_m]
    return {"type": LINE_STRIP, "points": points, "pose": {"orientation": {"w": 1.0}}, "scale": {"x": LINE_M}}
