"""Items of missions and fences as an autopilot sends them, for the tests of the edge to MAVLink."""

from __future__ import annotations

from typing import Any

import pymap3d

from ltv_mpc.references import Origin
from services.edges.mavlink.codec import Codec

ORIGIN = Origin(latitude_deg=50.2, longitude_deg=-5.1)


def codec(system: int = 1, component: int = 1, key: bytes | None = None) -> Codec:
    return Codec(system, key, component=component, stamp=10**13)


def item(seq: int, command: int, *parameters: float, north_m: float = 0.0, east_m: float = 0.0, **other: Any) -> Any:
    """Return an item at a place in metres from the origin; ``z`` and ``frame`` by name, and ``x``, ``y`` for none."""
    latitude, longitude, _ = pymap3d.ned2geodetic(north_m, east_m, 0.0, ORIGIN.latitude_deg, ORIGIN.longitude_deg, 0.0)
    fields = {"frame": 6, "z": 0.0, "x": round(latitude * 1e7), "y": round(longitude * 1e7)} | other
    four = (*parameters, 0.0, 0.0, 0.0, 0.0)[:4]
    place = fields["x"], fields["y"], fields["z"]
    return codec().make.mission_item_int_encode(1, 1, seq, fields["frame"], command, 0, 1, *four, *place)


def square(command: int, first: int = 0, side_m: float = 100.0) -> list[Any]:
    """Return the items of a square around the origin."""
    corners = ((-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5))
    return [
        item(first + at, command, 4.0, north_m=side_m * north, east_m=side_m * east)
        for at, (north, east) in enumerate(corners)
    ]
