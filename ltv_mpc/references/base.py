"""Common part of all references: start time, position at the start, and descent."""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec
from msgspec import Meta

from ltv_mpc.messages import Estimate, ReferenceStart
from ltv_mpc.references.geodesy import Depth, Origin

MAX_BACKDATE_S = 1.0
"""Longest time over which the position at the start is extrapolated back from the first estimate after it. If more time
has passed, the reference starts at that estimate.
"""


class BaseReference(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind"):
    """Base class of all references.

    Before ``start_s`` (vehicle time) the lateral thrusters are at rest, and the command of the vertical one is kept.
    A reference without a depth (``depth_m``, or depths of its places) leaves the vertical thruster as it is. With a
    depth, the wanted depth begins at that of the vehicle and changes by at most ``descent_rate_mps``. ``origin`` is the
    position of north = east = 0, for places given in degrees.
    """

    in_places: ClassVar[bool] = True
    """It is given in places; False: it begins where the vehicle is."""

    start_s: Annotated[float, Meta(ge=-1e6, le=1e6)] | None = None  # None: at once
    depth_m: Depth | None = None
    descent_rate_mps: Annotated[float, Meta(gt=0, le=10)] = 0.2
    origin: Origin | None = None

    def has_started(self, t_ns: int) -> bool:
        """Return True if the reference is in force at ``t_ns``.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        return self.start_s is None or t_ns >= round(self.start_s * 1e9)

    def anchor(self, estimate: Estimate) -> ReferenceStart:
        """Return position and motion at the start time, extrapolated back from the first estimate after it.

        Parameters
        ----------
        estimate : first estimate after the start time. An unknown depth or sinking speed counts as 0.
        """
        start_ns = estimate.t_ns if self.start_s is None else min(round(self.start_s * 1e9), estimate.t_ns)
        back_s = (estimate.t_ns - start_ns) * 1e-9
        if back_s > MAX_BACKDATE_S:
            start_ns, back_s = estimate.t_ns, 0.0
        depth = (estimate.depth_m or 0.0) - back_s * (estimate.velocity_down_mps or 0.0)
        return ReferenceStart(
            t_ns=start_ns,
            north_m=estimate.north_m - back_s * estimate.velocity_north_mps,
            east_m=estimate.east_m - back_s * estimate.velocity_east_mps,
            depth_m=max(depth, 0.0),
            heading_rad=estimate.heading_rad,
            velocity_mps=(estimate.velocity_north_mps, estimate.velocity_east_mps),
        )
