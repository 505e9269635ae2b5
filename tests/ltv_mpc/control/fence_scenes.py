"""Scene of zones and a moving obstacle, for the tests of clearances and of the rows of the QP."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from ltv_mpc.control.ocp.fence import NO_PATH, Scene
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.geofence.zones import pack_zones
from tests.ltv_mpc.control.problems import PAPER
from tests.ltv_mpc.geofence.shapes import disc, polygon

STAGES = 17

SMALL = msgspec.structs.replace(PAPER, surge=msgspec.structs.replace(PAPER.surge, mass_kg=0.5 * PAPER.surge.mass_kg))
"""A vehicle whose position scale is not 1 m."""

WALLS = Fence(
    margin_m=0.4,
    keep_in=(polygon(np.array([[-3.0, -3.0], [-3.0, 4.0], [5.0, 4.0], [5.0, -3.0]])),),
    keep_out=(polygon(np.array([[1.0, 1.0], [2.5, 1.4], [1.2, 2.6]])),),
    keep_out_disc=(disc(3.0, -1.5, 0.8),),
)


def scene(**changed: Any) -> Scene:
    """Return a scene with the zones of ``WALLS`` and one moving obstacle; ``changed`` replaces fields."""
    zones = pack_zones(WALLS)
    return Scene(
        zones=zones,
        need=0.3 + zones.margin,
        exits=np.zeros((len(zones.radius), 4)),
        discs=np.array([[-2.0, 1.0, 0.05, -0.1, 0.5, 0.04, 1.5]]),
        disc_need_m=np.array([0.6]),
        stage_s=0.3,
        path=NO_PATH,
        targets=np.zeros(STAGES, dtype=np.int64),
        path_reach=0,
        half_width_m=0.0,
    )._replace(**changed)
