"""Rotation of a quaternion, and the covariance of an estimate from those of a pose and a twist.

A small attitude error d, about the axes of the world, affects the velocity v and the angular velocity w too:

    R -> (1 + [d]) R,    d(R v) = -[R v] d + R dv,    d(R w)_down = (-[R w] d + R dw)_down

The covariance of the estimate is J P J^T with P = diag(pose, twist).
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.messages import Array
from services.edges.edge import Refused

UNIT = 1e-3
"""Largest deviation of a quaternion's length from 1."""


def rotation(w: float, x: float, y: float, z: float) -> Array:
    """Return R (3, 3) of a quaternion, body to world. Raises ``Refused`` if its length is not 1."""
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(length - 1.0) <= UNIT:  # also true for NaN
        raise Refused(f"orientation: a quaternion of length {length:.3g}, not 1")
    cross = np.cross(np.eye(3), (x / length, y / length, z / length))  # [v], of the vector part
    R: Array = np.eye(3) + 2.0 * w / length * cross + 2.0 * cross @ cross
    return R


def wrapped(angle: float) -> float:
    """Return an angle in [-pi, pi]. That of ``ltv_mpc.frames`` is compiled, for which each process needs 40 MB."""
    return math.remainder(angle, math.tau)


def covariance(R: Array, velocity: Array, rate: Array, pose: Array, twist: Array) -> Array:
    """Return the covariance (6, 6) of north, east, velocity north, east, heading and yaw rate.

    Parameters
    ----------
    R : rotation (3, 3), body FRD to world NED.
    velocity, rate : velocity over ground and angular velocity (3,) in NED (m/s, rad/s).
    pose : covariance (6, 6) of the position and of rotations about the axes of NED.
    twist : covariance (6, 6) of velocity and angular velocity in FRD.
    """
    P = np.zeros((12, 12))
    P[:6, :6], P[6:, 6:] = pose, twist
    velocity_by_turn, rate_by_turn = -np.cross(np.eye(3), velocity), -np.cross(np.eye(3), rate)  # -[v], -[w]
    J = np.zeros((6, 12))
    J[0, 0] = J[1, 1] = J[4, 5] = 1.0
    J[2:4, 3:6], J[2:4, 6:9] = velocity_by_turn[:2], R[:2]
    J[5, 3:6], J[5, 9:12] = rate_by_turn[2], R[2]
    P = J @ P @ J.T
    return 0.5 * (P + P.T)
