"""Frames, rotations and Earth constants: the conventions of all other files.

World  NED (north, east, down), local and flat; body FRD (forward, starboard, down).
R      body to world, R = Rz(heading) Ry(pitch) Rx(roll), shape (3, 3): v_ned = R v_frd
phi    rotation vector (rad), shape (3,), R = exp(phi^): axis times angle
Earth  The Earth rate in NED at latitude L is Omega [cos L, 0, -sin L]. Gravity is one constant along down. Results do
       not depend on its value: simulation and filter use the same one, and no sensor measures it alone.
Source  Groves 2013, Principles of GNSS, inertial and multisensor integrated navigation systems, sections 2.2 and 2.3.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc import so3
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Triple

GRAVITY_MPS2 = 9.80665
"""Standard gravity (m/s2), along down, for all latitudes and depths."""

EARTH_RATE_RADPS = 7.292115e-5
"""Rotation rate of the Earth relative to inertial space (rad/s, WGS 84)."""


def gravity() -> Array:
    """Return the acceleration of gravity (m/s2, NED), (3,)."""
    return np.array([0.0, 0.0, GRAVITY_MPS2])


def earth_rate(latitude_rad: float) -> Array:
    """Return the Earth rate at a latitude (rad/s, NED), (3,)."""
    return EARTH_RATE_RADPS * np.array([math.cos(latitude_rad), 0.0, -math.sin(latitude_rad)])


@jit
def wrap_angle(angle: float) -> float:
    """Wrap an angle (rad) to (-pi, pi]. An angle in this interval is returned unchanged, bitwise."""
    if -math.pi < angle <= math.pi:
        return angle
    wrapped = math.pi - (math.pi - angle) % (2.0 * math.pi)
    return wrapped if wrapped > -math.pi else math.pi


def rotation(roll: float, pitch: float, heading: float) -> Array:
    """Return R = Rz(heading) Ry(pitch) Rx(roll), body to world, (3, 3).

    Parameters
    ----------
    roll, pitch, heading : Euler angles (rad).
    """
    return np.array(so3.from_angles(roll, pitch, heading)).reshape(3, 3)


def roll_pitch_heading(R: Array) -> Triple:
    """Return roll and heading in (-pi, pi] and pitch in [-pi/2, pi/2] (rad) of R (3, 3): inverse of ``rotation``."""
    (ahead, _, _), (aside, _, _), (r31, r32, r33) = R.tolist()
    return math.atan2(r32, r33), math.atan2(-r31, math.hypot(r32, r33)), math.atan2(aside, ahead)


def skew(a: Array) -> Array:
    """Return the skew-symmetric matrix a^ of a (3,), with a^ b = a x b, (3, 3)."""
    x, y, z = a.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation_exp(phi: Array) -> Array:
    """Return the rotation matrix exp(phi^) of a rotation vector phi (3,), (3, 3)."""
    return np.array(so3.exp(phi[0], phi[1], phi[2])).reshape(3, 3)


def rotation_log(R: Array) -> Array:
    """Return the rotation vector phi of R (3, 3) with |phi| <= pi (rad), (3,)."""
    return np.array(so3.log(so3.read(R)))
