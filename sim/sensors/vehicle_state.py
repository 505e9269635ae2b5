"""True motion at any instant between two truths.

Over the interval h between two truths: R(t1 + s h) = R1 exp(s phi), phi = log(R1^T R2), so the body's angular rate is
w = phi / h; position and velocity are linear (at 100 Hz and 0.3 m/s2 that is off by less than 4 um and 4 um/s).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.frames import rotation, rotation_exp, rotation_log
from ltv_mpc.messages import Array, Triple, Truth

_ORIGIN = (0.0, 0.0, 0.0)


class VehicleState(msgspec.Struct, frozen=True, eq=False):
    """True pose and motion. ``rotation`` is body to world, ``angular_rate_radps`` returns it in body axes."""

    t_ns: int
    position_m: Triple
    velocity_mps: Triple
    rotation: Array  # (3, 3)
    angular_rate_radps: Callable[[], Array]  # (3,), mean over the interval between the truths around it
    heading_rate_radps: float

    def point_m(self, lever_m: Triple) -> Triple:
        """Return the position of the vehicle's point ``lever_m`` (FRD): p + R l, NED."""
        if lever_m == _ORIGIN:
            return self.position_m
        return _plus(self.position_m, self.rotation @ np.array(lever_m))

    def point_velocity_mps(self, lever_m: Triple) -> Triple:
        """Return the velocity over ground of the vehicle's point ``lever_m``: v + R (w x l), NED."""
        if lever_m == _ORIGIN:
            return self.velocity_mps
        return _plus(self.velocity_mps, self.rotation @ np.cross(self.angular_rate_radps(), lever_m))


class Motion(NamedTuple):
    """Motion between two truths."""

    earlier: Truth
    later: Truth
    R1: Array  # (3, 3) of the earlier
    R2: Array  # of the later

    def phi(self) -> Array:
        """Return phi = log(R1^T R2), (3,)."""
        return rotation_log(self.R1.T @ self.R2)

    def rate(self) -> Array:
        """Return phi / h (rad/s), (3,). Few sensors need it, so it is computed when one does."""
        return self.phi() / ((self.later.t_ns - self.earlier.t_ns) * 1e-9)

    def at(self, t_ns: int) -> VehicleState:
        """Return the state at ``t_ns``, between the times of the two truths."""
        a, b = self.earlier, self.later
        if t_ns == b.t_ns:
            return VehicleState(t_ns, b.position_m, b.velocity_mps, self.R2, self.rate, b.yaw_rate_radps)
        s = (t_ns - a.t_ns) / (b.t_ns - a.t_ns)
        return VehicleState(
            t_ns,
            _mix(a.position_m, b.position_m, s),
            _mix(a.velocity_mps, b.velocity_mps, s),
            self.R1 @ rotation_exp(s * self.phi()),
            self.rate,
            a.yaw_rate_radps + s * (b.yaw_rate_radps - a.yaw_rate_radps),
        )


def motion_between(earlier: Truth, later: Truth, before: Motion | None = None) -> Motion:
    """Return the motion between two truths, the second of which must be later.

    ``before`` is the motion that ended with the first truth, if it is known: its rotation is then not computed again.
    """
    R1 = before.R2 if before is not None and before.later is earlier else rotation(*earlier.attitude_rad)
    return Motion(earlier, later, R1, rotation(*later.attitude_rad))


def _plus(a: Triple, b: Array) -> Triple:
    x, y, z = b.tolist()
    return a[0] + x, a[1] + y, a[2] + z


def _mix(a: Triple, b: Triple, s: float) -> Triple:
    return a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2])
