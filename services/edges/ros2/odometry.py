"""Conversion of nav_msgs/Odometry to an ``Estimate``: from ENU and FLU (REP 103) to NED and FRD.

In    position p and attitude R (body to world, from the quaternion) in ``header.frame_id``, ENU: x east, y north, z up
      velocity v and angular velocity w in ``child_frame_id``, FLU: x forward, y to port, z up
Out   north = p_y, east = p_x, depth = -p_z            z = 0 of the frame is the water's surface
      [east, north, up]' = R v                         the twist is the body's, the estimate's velocity is not
      heading = pi/2 - yaw,   yaw = atan2(R_yx, R_xx)  from north clockwise, instead of from east counter-clockwise
      yaw rate = -(R w)_z                              about the world's vertical

The axes of ``pose.covariance`` are those of ``header.frame_id``, those of ``twist.covariance`` those of
``child_frame_id``. By the customs of ROS a matrix is not given if its first entry is 0 or -1, and a quantity if its
variance is negative or at least ``UNKNOWN``. Such a quantity adds nothing to the others. If some are given, position
and heading that are not have the variances of ``NOT_GIVEN``, which the controller assumes without a covariance.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ltv_mpc.messages import Array, CurrentProfile, Estimate
from services.edges.edge import MAX_STAMP_NS, Refused
from services.edges.pose import covariance, rotation, wrapped

OTHER_CONVENTIONS = ("ned", "frd")
"""Suffixes by which REP 103 marks frames that are not ENU or FLU, as in ``odom_ned``."""

LARGEST = 1e9
UNKNOWN = {"pose": np.repeat([1e6, 10.0], 3), "twist": np.full(6, 1e6)}
"""Variances from which a quantity is not given; an angle of 10 rad^2, as of 1e5 or 99999, may be any."""

NOT_GIVEN = {0: (1, 5.0**2), 1: (0, 5.0**2), 5: (4, 0.5**2)}
"""Row of the estimate's covariance and its variance, by the row of the pose: x is east, y is north, then yaw."""

KINDS = "pose", "twist"

NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD = np.diag([1.0, -1.0, -1.0])
"""Rotations of ENU to NED and of FLU to FRD; each is its own inverse."""


def estimate_of(message: Any, current: CurrentProfile | None = None) -> Estimate:
    """Return the estimate of an odometry message, at the message's stamp. Raises ``Refused``.

    Parameters
    ----------
    message : odometry, or anything with the same fields.
    current : velocity of the water to add to the estimate.
    """
    check_frames(message.header.frame_id, message.child_frame_id)
    pose, twist = message.pose, message.twist
    q = pose.pose.orientation
    R = rotation(float(q.w), float(q.x), float(q.y), float(q.z))
    position = vector("position", pose.pose.position)
    velocity, rate = R @ vector("linear", twist.twist.linear), R @ vector("angular", twist.twist.angular)
    return Estimate(
        t_ns=stamp_ns(message.header),
        north_m=float(position[1]),
        east_m=float(position[0]),
        depth_m=float(-position[2]),
        heading_rad=wrapped(math.pi / 2.0 - math.atan2(R[1, 0], R[0, 0])),
        yaw_rate_radps=float(-rate[2]),
        velocity_north_mps=float(velocity[1]),
        velocity_east_mps=float(velocity[0]),
        velocity_down_mps=float(-velocity[2]),
        covariance=_covariance(R, velocity, rate, message),
        current=current,
    )


def check_frames(*names: str) -> None:
    """Raise ``Refused`` if the name of a frame says that it is not ENU or FLU."""
    for name in names:
        if name.lower().rpartition("_")[2] in OTHER_CONVENTIONS:
            raise Refused(f"frame {name}: must be ENU, its child FLU (REP 103)")


def stamp_ns(header: Any) -> int:
    """Return the stamp of a header (ns). Raises ``Refused`` for one that is no time, or one that soon has no room."""
    sec, nanosec = int(header.stamp.sec), int(header.stamp.nanosec)
    t_ns = sec * 1_000_000_000 + nanosec
    if not (0 <= t_ns <= MAX_STAMP_NS and nanosec < 1_000_000_000):
        raise Refused(f"stamp = {sec} s, {nanosec} ns: must be from 0 to {MAX_STAMP_NS / 1e9:.0f} s")
    return t_ns


def vector(name: str, message: Any) -> Array:
    """Return x, y, z of a message, shape (3,). Raises ``Refused`` if one is not finite."""
    return _bounded(name, np.array([message.x, message.y, message.z], dtype=np.float64))


def _matrix(name: str, covariance: Any) -> tuple[Array, Array]:
    """Return a covariance (6, 6) with zeros for what is not given, and what is given (6,). Raises ``Refused``."""
    P = np.array(covariance, dtype=np.float64).reshape(6, 6)
    variance = P.diagonal().copy()
    if np.isnan(P).any():
        raise Refused(f"{name}.covariance: a value is not a number")
    given = (variance >= 0.0) & (variance < UNKNOWN[name]) & (variance[0] > 0.0)
    P[~given], P[:, ~given] = 0.0, 0.0
    return _bounded(f"{name}.covariance", P), given


def _bounded(name: str, values: Array) -> Array:
    """Return finite values within LARGEST; the bounds of a vehicle are checked by the message validation."""
    if not np.abs(values).max() <= LARGEST:  # also true for NaN
        raise Refused(f"{name}: a value is not a number, or larger than {LARGEST:g}")
    return values


def _covariance(R: Array, velocity: Array, rate: Array, message: Any) -> Array | None:
    """Return the covariance (6, 6) of the estimate; None if nothing of it is given. Arguments in ENU and FLU."""
    (pose, pose_given), (twist, twist_given) = (_matrix(name, getattr(message, name).covariance) for name in KINDS)
    if not (pose_given[[0, 1, 5]].any() or twist_given[[0, 1, 5]].any()):
        return None
    world, body = np.kron(np.eye(2), NED), np.kron(np.eye(2), FRD)
    P = covariance(NED @ R @ FRD, NED @ velocity, NED @ rate, world @ pose @ world, body @ twist @ body)
    for row, (to, variance) in NOT_GIVEN.items():
        P[to, to] += 0.0 if pose_given[row] else variance
    return P
