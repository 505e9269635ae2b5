"""What every kind of reference has: when it begins, where the vehicle was then, and how it goes down."""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Estimate, ReferenceStart, Times
from ltv_mpc.references.geodesy import Depth, Origin

LONGEST_BACK_S = 1.0
"""A vehicle that drifts is where it was, less its velocity times the time since: for so long. Later, "here" is now."""


class BaseReference(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind"):
    """Until ``start_s`` (vehicle time) the vehicle is left alone; without a depth the vertical thruster is not used.

    In depth it goes down (or up) from where the vehicle is at the start, at no more than ``descent_rate_mps``.
    ``origin`` is where north = east = 0 is, for places given in degrees.
    """

    start_s: Annotated[float, Meta(ge=-1e6, le=1e6)] | None = None  # at once where it is left out
    depth_m: Depth | None = None
    descent_rate_mps: Annotated[float, Meta(gt=0, le=10)] = 0.2
    origin: Origin | None = None

    def has_started(self, t_ns: int) -> bool:
        """Whether it is in force at ``t_ns``."""
        return self.start_s is None or t_ns >= round(self.start_s * 1e9)

    def anchor(self, estimate: Estimate) -> ReferenceStart:
        """Where it begins: where the first estimate after its start says that the vehicle was at the start."""
        start_ns = estimate.t_ns if self.start_s is None else min(round(self.start_s * 1e9), estimate.t_ns)
        back_s = (estimate.t_ns - start_ns) * 1e-9
        if back_s > LONGEST_BACK_S:
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


@jit
def ramp(t_ns: Times, begun_ns: int, start: float, end: float, rate: float) -> tuple[Array, Array]:
    """Depth and speed at each time, from ``start`` at ``begun_ns`` to ``end`` at ``rate``, then at rest."""
    depth, speed = np.empty(len(t_ns)), np.empty(len(t_ns))
    sign = np.sign(end - start)
    for k in range(len(t_ns)):
        way = max(float(t_ns[k] - begun_ns) * 1e-9, 0.0) * rate
        moving = way < abs(end - start)
        depth[k] = start + sign * way if moving else end
        speed[k] = sign * rate if moving else 0.0
    return depth, speed
