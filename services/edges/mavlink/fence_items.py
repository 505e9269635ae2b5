"""Fence file of the fence items of an autopilot."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ltv_mpc import config
from ltv_mpc.config import to_toml
from ltv_mpc.geofence.fence import Disc, Fence, Polygon
from ltv_mpc.messages import Action, Command
from ltv_mpc.references.geodesy import Origin, Place, local
from ltv_mpc.validation import rejection_reason
from services.edges.mavlink.download import ListRefused

KEEP_IN, KEEP_OUT, CIRCLE_IN, CIRCLE_OUT = 5001, 5002, 5003, 5004  # MAV_CMD_NAV_FENCE
MARGIN_M = 1.0
"""Margin of the zones of an autopilot, which sends none."""

MAX_RADIUS_M = 100_000.0
CORNERS = 32
"""Vertices of the polygon in a circle that the vehicle must not leave."""


def fence_of(items: Iterable[Any], origin: Origin) -> str:
    """Return the fence file of the items of a fence; empty if it has no zone.

    The vertices of a polygon follow one another, and each has their number. A circle not to leave becomes the polygon
    in it. Raises ``ListRefused`` for a polygon that is not complete or that crosses itself.
    """
    polygons: dict[int, list[Polygon]] = {KEEP_IN: [], KEEP_OUT: []}
    discs: list[Disc] = []
    ring: list[Any] = []
    try:
        for item in items:
            centre = Place(latitude_deg=item.x * 1e-7, longitude_deg=item.y * 1e-7)
            if ring and item.command != ring[0].command:
                raise ListRefused(
                    f"fence: polygon before item {item.seq} has {len(ring)} of {ring[0].param1:g} vertices"
                )
            if item.command in polygons:
                ring.append(item)
                if len(ring) == item.param1:
                    places = (Place(latitude_deg=one.x * 1e-7, longitude_deg=one.y * 1e-7) for one in ring)
                    polygons[item.command].append(Polygon(vertices=tuple(places)))
                    ring = []
            elif item.command in (CIRCLE_IN, CIRCLE_OUT) and not 0.0 < item.param1 <= MAX_RADIUS_M:
                raise ListRefused(
                    f"fence: radius of item {item.seq} = {item.param1:g} m, must be 0 to {MAX_RADIUS_M:g}"
                )
            elif item.command == CIRCLE_OUT:
                discs.append(Disc(centre=centre, radius_m=item.param1))
            elif item.command == CIRCLE_IN:
                north_m, east_m = local(centre, origin)
                angles = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
                corners = item.param1 * np.column_stack([np.cos(angles), np.sin(angles)]) + (north_m, east_m)
                places = (Place(north_m=float(north), east_m=float(east)) for north, east in corners)
                polygons[KEEP_IN].append(Polygon(vertices=tuple(places)))
        if ring:
            raise ListRefused(f"fence: the last polygon has {len(ring)} of {ring[0].param1:g} vertices")
        if not (discs or any(polygons.values())):
            return ""
        fence = Fence(
            margin_m=MARGIN_M,
            origin=origin,
            keep_in=tuple(polygons[KEEP_IN]),
            keep_out=tuple(polygons[KEEP_OUT]),
            keep_out_disc=tuple(discs),
        )
        text = to_toml(fence)
        config.parse(config.loads(text), Fence, source="fence")  # with the bounds of each field
    except ListRefused:
        raise
    except ValueError as error:
        raise ListRefused(f"fence: {error}") from None
    if (reason := rejection_reason(Command(command_id=0, action=Action.FENCE, fence_toml=text))) is not None:
        raise ListRefused(f"fence: {reason}")
    return text
