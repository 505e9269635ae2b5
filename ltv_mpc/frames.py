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


@jit
def rotation(roll: float, pitch: float, heading: float) -> Array:
    """Return R = Rz(heading) Ry(pitch) Rx(roll), body to world, (3, 3).

    Parameters
    ----------
    roll, pitch, heading : Euler angles (rad).
    """
    R = np.empty((3, 3))
    so3.write(so3.from_angles(roll, pitch, heading), R)
    return R


@jit
def roll_pitch_heading(R: Array) -> Triple:
    """Return roll and heading in (-pi, pi] and pitch in [-pi/2, pi/2] (rad) of R (3, 3): inverse of ``rotation``."""
    pitch = math.atan2(-R[2, 0], math.hypot(R[2, 1], R[2, 2]))
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


@jit
def skew(a: Array) -> Array:
    """Return the skew-symmetric matrix a^ of a (3,), with a^ b = a x b, (3, 3)."""
    S = np.zeros((3, 3))
    S[0, 1], S[0, 2] = -a[2], a[1]
    S[1, 0], S[1, 2] = a[2], -a[0]
    S[2, 0], S[2, 1] = -a[1], a[0]
    return S


@jit
def rotation_exp(phi: Array) -> Array:
    """Return the rotation matrix exp(phi^) of a rotation vector phi (3,), (3, 3)."""
    R = np.empty((3, 3))
    so3.write(so3.exp(phi[0], phi[1], phi[2]), R)
    return R


@jit
def rotation_log(R: Array) -> Array:
    """Return the rotation vector phi of R (3, 3) with |phi| <= pi (rad), (3,)."""
    phi = np.empty(3)
    phi[0], phi[1], phi[2] = so3.log(so3.read(R))
    return phi
