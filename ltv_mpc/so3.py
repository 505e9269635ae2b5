"""Rotation matrices as tuples of nine numbers, for compiled code.

In compiled code a small array costs two calls to the allocator; nine numbers stay in registers. The conventions are in
``frames.py``.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array, Triple

Matrix3: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]
"""Matrix (3, 3), row by row."""

SMALL = 1e-4
"""Angle (rad) below which the fourth-order series is exact to double precision."""


@jit
def read(R: Array) -> Matrix3:
    """Read an array (3, 3) into a tuple."""
    return R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2]


@jit
def write(M: Matrix3, R: Array) -> None:
    """Write a tuple into an array.

    Parameters
    ----------
    M : matrix as a tuple.
    R : (3, 3) array; changes.
    """
    R[0, 0], R[0, 1], R[0, 2] = M[0], M[1], M[2]
    R[1, 0], R[1, 1], R[1, 2] = M[3], M[4], M[5]
    R[2, 0], R[2, 1], R[2, 2] = M[6], M[7], M[8]


@jit
def transpose(M: Matrix3) -> Matrix3:
    """Return M^T."""
    return M[0], M[3], M[6], M[1], M[4], M[7], M[2], M[5], M[8]


@jit
def multiply(A: Matrix3, B: Matrix3) -> Matrix3:
    """Return the product of two matrices.

    Parameters
    ----------
    A, B : matrices.
    """
    return (
        A[0] * B[0] + A[1] * B[3] + A[2] * B[6],
        A[0] * B[1] + A[1] * B[4] + A[2] * B[7],
        A[0] * B[2] + A[1] * B[5] + A[2] * B[8],
        A[3] * B[0] + A[4] * B[3] + A[5] * B[6],
        A[3] * B[1] + A[4] * B[4] + A[5] * B[7],
        A[3] * B[2] + A[4] * B[5] + A[5] * B[8],
        A[6] * B[0] + A[7] * B[3] + A[8] * B[6],
        A[6] * B[1] + A[7] * B[4] + A[8] * B[7],
        A[6] * B[2] + A[7] * B[5] + A[8] * B[8],
    )


@jit
def from_angles(roll: float, pitch: float, heading: float) -> Matrix3:
    """Return R = Rz(heading) Ry(pitch) Rx(roll), body to world.

    Parameters
    ----------
    roll, pitch, heading : Euler angles (rad).
    """
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    ch, sh = math.cos(heading), math.sin(heading)
    return (
        ch * cp, ch * sp * sr - sh * cr, ch * sp * cr + sh * sr,
        sh * cp, sh * sp * sr + ch * cr, sh * sp * cr - ch * sr,
        -sp, cp * sr, cp * cr,
    )  # fmt: skip


@jit
def exp(x: float, y: float, z: float) -> Matrix3:
    """Return exp(phi^) = I + sin(t)/t phi^ + (1 - cos t)/t^2 phi^ phi^ with t = |phi| (Rodrigues).

    Parameters
    ----------
    x, y, z : rotation vector phi (rad).
    """
    t2 = x * x + y * y + z * z
    t = math.sqrt(t2)
    if t < SMALL:
        a = 1.0 - t2 / 6.0
        b = 0.5 - t2 / 24.0
    else:
        a = math.sin(t) / t
        half = math.sin(0.5 * t) / t  # 1 - cos t = 2 sin^2(t/2), without cancellation
        b = 2.0 * half * half
    return (
        1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y,
        b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x,
        b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y),
    )  # fmt: skip


@jit_outlined
def strapdown(R: Matrix3, W: Triple, w: Triple, dt: float) -> Matrix3:
    """Return the attitude after dt, exp(-W dt) R exp(w dt).

    Parameters
    ----------
    R : attitude, body to NED.
    W : Earth rate (rad/s, NED).
    w : angular rate relative to inertial space (rad/s, FRD).
    dt : duration (s).
    """
    world = exp(-dt * W[0], -dt * W[1], -dt * W[2])
    return multiply(multiply(world, R), exp(dt * w[0], dt * w[1], dt * w[2]))


@jit
def log(M: Matrix3) -> Triple:
    """Return the rotation vector phi of M, |phi| <= pi (rad)."""
    # (M - M^T) / 2 = sin(t) axis^,  (trace M - 1) / 2 = cos(t)
    x, y, z = 0.5 * (M[7] - M[5]), 0.5 * (M[2] - M[6]), 0.5 * (M[3] - M[1])
    sine = math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (M[0] + M[4] + M[8] - 1.0)
    t = math.atan2(sine, cosine)
    if cosine > -0.9:
        part = 1.0 + sine * sine / 6.0 if sine < SMALL else t / sine
        return part * x, part * y, part * z
    # Near t = pi the sine vanishes. Then the axis follows from M + M^T = 2 cos(t) I + 2 (1 - cos t) axis axis^T, from
    # the row with the largest diagonal element.
    if M[0] >= M[4] and M[0] >= M[8]:
        sign = 1.0 if x >= 0.0 else -1.0
        x, y, z = M[0] - cosine, 0.5 * (M[1] + M[3]), 0.5 * (M[2] + M[6])
    elif M[4] >= M[8]:
        sign = 1.0 if y >= 0.0 else -1.0
        x, y, z = 0.5 * (M[1] + M[3]), M[4] - cosine, 0.5 * (M[5] + M[7])
    else:
        sign = 1.0 if z >= 0.0 else -1.0
        x, y, z = 0.5 * (M[2] + M[6]), 0.5 * (M[5] + M[7]), M[8] - cosine
    part = sign * t / math.sqrt(x * x + y * y + z * z)
    return part * x, part * y, part * z
