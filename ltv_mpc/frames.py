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

from ltv_mpc.compiled import kernel
from ltv_mpc.signals import Array, Triple

GRAVITY_MPS2 = 9.80665
"""Standard gravity, along down, at every latitude and depth."""

EARTH_RATE_RADPS = 7.292115e-5
"""Rotation of the Earth against the stars (WGS 84)."""

_SMALL = 1e-4
"""Angle (rad) below which the series to the fourth power is exact to double precision."""


def gravity() -> Array:
    """Acceleration of free fall (m/s2), NED, shape (3,)."""
    return np.array([0.0, 0.0, GRAVITY_MPS2])


def earth_rate(latitude_rad: float) -> Array:
    """Angular velocity of the Earth (rad/s), NED, shape (3,)."""
    return EARTH_RATE_RADPS * np.array([math.cos(latitude_rad), 0.0, -math.sin(latitude_rad)])


@kernel
def wrap_angle(angle: float) -> float:
    """The same angle in (-pi, pi]; an angle that lies there already is returned bit for bit."""
    if -math.pi < angle <= math.pi:
        return angle
    wrapped = math.pi - (math.pi - angle) % (2.0 * math.pi)
    return wrapped if wrapped > -math.pi else math.pi


@kernel
def rotation(roll: float, pitch: float, heading: float) -> Array:
    """R = Rz(heading) Ry(pitch) Rx(roll), body to world, shape (3, 3)."""
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    ch, sh = math.cos(heading), math.sin(heading)
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = ch * cp, ch * sp * sr - sh * cr, ch * sp * cr + sh * sr
    R[1, 0], R[1, 1], R[1, 2] = sh * cp, sh * sp * sr + ch * cr, sh * sp * cr - ch * sr
    R[2, 0], R[2, 1], R[2, 2] = -sp, cp * sr, cp * cr
    return R


@kernel
def roll_pitch_heading(R: Array) -> Triple:
    """The angles of ``rotation``: roll and heading in (-pi, pi], pitch in [-pi/2, pi/2]."""
    pitch = math.atan2(-R[2, 0], math.hypot(R[2, 1], R[2, 2]))
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


@kernel
def skew(a: Array) -> Array:
    """a^ with a^ b = a x b, shape (3, 3)."""
    S = np.zeros((3, 3))
    S[0, 1], S[0, 2] = -a[2], a[1]
    S[1, 0], S[1, 2] = a[2], -a[0]
    S[2, 0], S[2, 1] = -a[1], a[0]
    return S


@kernel
def product(A: Array, B: Array) -> Array:
    """A B of two (3, 3): in compiled code, where a library's call takes longer than the sums."""
    C = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            C[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
    return C


@kernel
def rotation_exp(phi: Array) -> Array:
    """exp(phi^) = I + sin(t)/t phi^ + (1 - cos t)/t^2 phi^ phi^ with t = |phi|, shape (3, 3)."""
    x, y, z = phi[0], phi[1], phi[2]
    t2 = x * x + y * y + z * z
    t = math.sqrt(t2)
    if t < _SMALL:
        a = 1.0 - t2 / 6.0
        b = 0.5 - t2 / 24.0
    else:
        a = math.sin(t) / t
        half = math.sin(0.5 * t) / t  # 1 - cos t = 2 sin^2(t/2), without cancellation
        b = 2.0 * half * half
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    R[1, 0], R[1, 1], R[1, 2] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    R[2, 0], R[2, 1], R[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)
    return R


@kernel
def rotation_log(R: Array) -> Array:
    """The rotation vector phi of R, |phi| <= pi, shape (3,)."""
    phi = np.empty(3)
    # (R - R^T) / 2 = sin(t) axis^,  (trace R - 1) / 2 = cos(t)
    phi[0] = 0.5 * (R[2, 1] - R[1, 2])
    phi[1] = 0.5 * (R[0, 2] - R[2, 0])
    phi[2] = 0.5 * (R[1, 0] - R[0, 1])
    sine = math.sqrt(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    t = math.atan2(sine, cosine)
    if cosine > -0.9:
        phi *= 1.0 + sine * sine / 6.0 if sine < _SMALL else t / sine
        return phi
    # Near half a turn the sine vanishes: the axis comes from R + R^T = 2 cos(t) I + 2 (1 - cos t) axis axis^T.
    j = 0
    for i in range(1, 3):
        if R[i, i] > R[j, j]:
            j = i
    sign = 1.0 if phi[j] >= 0.0 else -1.0
    for i in range(3):
        phi[i] = 0.5 * (R[i, j] + R[j, i]) - (cosine if i == j else 0.0)
    phi *= sign * t / math.sqrt(phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2])
    return phi
