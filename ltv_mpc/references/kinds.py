"""The kinds of reference. A reference gives the position and the depth that are wanted at each knot.

Until ``start_s`` (vehicle time) the vehicle is left alone. ``Hold`` anchors at the first estimate after the start: the
vertical line "here". In depth both go down (or up) from where the vehicle is at the start, at ``descent_rate_mps``, to
``depth_m``; without a ``depth_m`` the vertical thruster is not used.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.compiled import kernel
from ltv_mpc.signals import Array, Estimate, Pair, Times

Metres: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6)]


LONGEST_BACK_S = 1.0
"""A vehicle that drifts is where it was, less its velocity times the time since: for so long. Later, "here" is now."""


class Anchor(msgspec.Struct, frozen=True):
    """Where and when the reference began."""

    t_ns: int
    north_m: float
    east_m: float
    depth_m: float


class _Kind(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind"):
    start_s: Annotated[float, Meta(ge=-1e6, le=1e6)] | None = None  # at once where it is left out
    depth_m: Annotated[float, Meta(ge=0, le=11_000)] | None = None
    descent_rate_mps: Annotated[float, Meta(gt=0, le=10)] = 0.2

    def begun(self, t_ns: int) -> bool:
        """Whether it is in force at ``t_ns``."""
        return self.start_s is None or t_ns >= round(self.start_s * 1e9)

    def anchor(self, estimate: Estimate) -> Anchor:
        """Where it begins: where the first estimate after its start says that the vehicle was at the start."""
        start_ns = estimate.t_ns if self.start_s is None else min(round(self.start_s * 1e9), estimate.t_ns)
        back_s = (estimate.t_ns - start_ns) * 1e-9
        if back_s > LONGEST_BACK_S:
            start_ns, back_s = estimate.t_ns, 0.0
        depth = (estimate.depth_m or 0.0) - back_s * (estimate.velocity_down_mps or 0.0)
        return Anchor(
            start_ns,
            estimate.north_m - back_s * estimate.velocity_north_mps,
            estimate.east_m - back_s * estimate.velocity_east_mps,
            max(depth, 0.0),
        )

    def depths(self, t_ns: Times, anchor: Anchor) -> tuple[Array, Array] | None:
        """Depth (m) and sinking speed (m/s) wanted at each time, (M,) each, or None."""
        if self.depth_m is None:
            return None
        return ramp(t_ns, anchor.t_ns, anchor.depth_m, self.depth_m, self.descent_rate_mps)


@kernel
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


class Point(_Kind, frozen=True, kw_only=True, tag="point"):
    """Stay on the vertical line through a point."""

    north_m: Metres
    east_m: Metres

    def position(self, anchor: Anchor) -> Pair:
        """North and east (m)."""
        del anchor
        return self.north_m, self.east_m


class Hold(_Kind, frozen=True, kw_only=True, tag="hold"):
    """Stay on the vertical line through where the vehicle is believed to be at the start."""

    def position(self, anchor: Anchor) -> Pair:
        """North and east (m)."""
        return anchor.north_m, anchor.east_m


Reference: TypeAlias = Point | Hold


def load(name: str) -> Reference:
    """A shipped reference by name (``"descent"``, ``"hover"``), or a TOML file by path. Raises ``ConfigError``."""
    reference: Reference = config.load(name, Reference, what="reference", package="ltv_mpc.references.files")  # type: ignore[arg-type]
    return reference
