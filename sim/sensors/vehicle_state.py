"""True motion at any instant between two truths.

Over the interval h between two truths: R(t1 + s h) = R1 exp(s phi), phi = log(R1^T R2), so the body's angular rate is
w = phi / h; position and velocity are linear (at 100 Hz and 0.3 m/s2 that is off by less than 4 um and 4 um/s).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc import so3
from ltv_mpc.frames import rotation
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Triple, Truth

_ORIGIN = (0.0, 0.0, 0.0)


class VehicleState(msgspec.Struct, frozen=True, eq=False):
    """True pose and motion. ``rotation`` is body to world, ``angular_rate_radps`` in body axes."""

    t_ns: int
    position_m: Triple
    velocity_mps: Triple
    rotation: Array  # (3, 3)
    angular_rate_radps: Array  # (3,), mean over the interval between the truths around it
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
        return _plus(self.velocity_mps, self.rotation @ np.cross(self.angular_rate_radps, lever_m))


class Motion(NamedTuple):
    """Motion between two truths."""

    earlier: Truth
    later: Truth
    R1: Array  # (3, 3) of the earlier
    R2: Array  # of the later
    phi: Array  # (3,) log(R1^T R2)
    rate: Array  # (3,) phi / h

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
            interpolated_rotation(self.R1, self.phi, s),
            self.rate,
            a.yaw_rate_radps + s * (b.yaw_rate_radps - a.yaw_rate_radps),
        )


class Motions:
    """Motions between K + 1 successive truths. A motion is computed when it is indexed."""

    def __init__(self, truths: Sequence[Truth], rotation: Array, phi: Array, rate: Array) -> None:
        """``rotation`` (K+1, 3, 3), ``phi`` and ``rate`` (K, 3) as in ``Motion``."""
        self.truths, self.rotation = truths, rotation
        self._phi, self._rate = phi, rate

    def __len__(self) -> int:
        return len(self._phi)

    def __getitem__(self, k: int) -> Motion:
        """Return the motion from truth k to the next, k >= 0."""
        if k >= len(self):
            raise IndexError(k)
        R = self.rotation
        return Motion(self.truths[k], self.truths[k + 1], R[k], R[k + 1], self._phi[k], self._rate[k])


def motions_between(truths: Sequence[Truth], before: Motion | None = None) -> Motions:
    """Return the motions from each truth to the next, which must be later.

    ``before`` is the motion that ended with the first truth, if it is known: its rotation is then not computed again.
    """
    first = truths[0]
    R1 = before.R2 if before is not None and before.later is first else rotation(*first.attitude_rad)
    attitude = np.array([truth.attitude_rad for truth in truths[1:]])
    t_ns = np.array([truth.t_ns for truth in truths])
    return Motions(truths, *rotations_and_rates(R1, attitude, (t_ns[1:] - t_ns[:-1]) * 1e-9))


def _plus(a: Triple, b: Array) -> Triple:
    x, y, z = b.tolist()
    return a[0] + x, a[1] + y, a[2] + z


def _mix(a: Triple, b: Triple, s: float) -> Triple:
    return a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2])


@jit
def rotations_and_rates(R1: Array, attitude: Array, h: Array) -> tuple[Array, Array, Array]:
    """Return rotations (K+1, 3, 3), phi = log(R_k^T R_k+1) (K, 3) and w = phi / h (K, 3).

    The rotations are R1 and those of the attitudes (K, 3); ``h`` (K,) are the intervals (s).
    """
    K = len(h)
    R, phi, w = np.empty((K + 1, 3, 3)), np.empty((K, 3)), np.empty((K, 3))
    here = so3.read(R1)
    so3.write(here, R[0])
    for k in range(K):
        before, here = here, so3.from_angles(attitude[k, 0], attitude[k, 1], attitude[k, 2])
        so3.write(here, R[k + 1])
        turn = so3.log(so3.multiply(so3.transpose(before), here))
        for i in range(3):
            phi[k, i], w[k, i] = turn[i], turn[i] / h[k]
    return R, phi, w


@jit
def interpolated_rotation(R1: Array, phi: Array, s: float) -> Array:
    """Return R1 exp(s phi), (3, 3)."""
    R = np.empty((3, 3))
    so3.write(so3.multiply(so3.read(R1), so3.exp(s * phi[0], s * phi[1], s * phi[2])), R)
    return R
