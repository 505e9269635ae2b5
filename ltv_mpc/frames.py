"""Frames, rotations and the Earth: the conventions that every other file leans on.

World  NED (north, east, down), local and flat; body FRD (forward, starboard, down).
R      body to world, R = Rz(heading) Ry(pitch) Rx(roll), shape (3, 3): v_ned = R v_frd
phi    rotation vector (rad), shape (3,), R = exp(phi^): axis times angle
Earth  its rate in NED at latitude L is Omega [cos L, 0, -sin L]; gravity is one constant along down (the figures of a
       run do not depend on it: simulation and filter use the same value, and no instrument measures it by itself).
Source  Groves 2013, Principles of GNSS, inertial and multisensor integrated navigation systems, sections 2.2 and 2.3.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc import so3
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Triple

GRAVITY_MPS2 = 9.80665
"""Standard gravity, along down, at every latitude and depth."""

EARTH_RATE_RADPS = 7.292115e-5
"""Rotation of the Earth against the stars (WGS 84)."""


def gravity() -> Array:
    """Acceleration of free fall (m/s2), NED, shape (3,)."""
    return np.array([0.0, 0.0, GRAVITY_MPS2])


def earth_rate(latitude_rad: float) -> Array:
    """Angular velocity of the Earth (rad/s), NED, shape (3,)."""
    return EARTH_RATE_RADPS * np.array([math.cos(latitude_rad), 0.0, -math.sin(latitude_rad)])


@jit
def wrap_angle(angle: float) -> float:
    """The same angle in (-pi, pi]; an angle that lies there already is returned bit for bit."""
    if -math.pi < angle <= math.pi:
        return angle
    wrapped = math.pi - (math.pi - angle) % (2.0 * math.pi)
    return wrapped if wrapped > -math.pi else math.pi


@jit
def rotation(roll: float, pitch: float, heading: float) -> Array:
    """R = Rz(heading) Ry(pitch) Rx(roll), body to world, shape (3, 3)."""
    R = np.empty((3, 3))
    so3.write(so3.from_angles(roll, pitch, heading), R)
    return R


@jit
def roll_pitch_heading(R: Array) -> Triple:
    """The angles of ``rotation``: roll and heading in (-pi, pi], pitch in [-pi/2, pi/2]."""
    pitch = math.atan2(-R[2, 0], math.hypot(R[2, 1], R[2, 2]))
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


@jit
def skew(a: Array) -> Array:
    """a^ with a^ b = a x b, shape (3, 3)."""
    S = np.zeros((3, 3))
    S[0, 1], S[0, 2] = -a[2], a[1]
    S[1, 0], S[1, 2] = a[2], -a[0]
    S[2, 0], S[2, 1] = -a[1], a[0]
    return S


@jit
def rotation_exp(phi: Array) -> Array:
    """exp(phi^), shape (3, 3)."""
    R = np.empty((3, 3))
    so3.write(so3.exp(phi[0], phi[1], phi[2]), R)
    return R


@jit
def rotation_log(R: Array) -> Array:
    """The rotation vector phi of R, |phi| <= pi, shape (3,)."""
    phi = np.empty(3)
    phi[0], phi[1], phi[2] = so3.log(so3.read(R))
    return phi
