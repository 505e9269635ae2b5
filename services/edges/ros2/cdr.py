"""Encoding of ROS 2 messages: CDR with its 4-byte header, the payload of zenoh-plugin-ros2dds.

``rosbags`` has the message definitions. It is pure Python; ROS itself is not needed.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

MAX_BYTES = 65_536
"""Largest accepted payload. An odometry message has some 720 bytes and two names of frames."""

LITTLE_ENDIAN, BIG_ENDIAN = b"\x00\x01", b"\x00\x00"
ODOMETRY, FLOAT64 = "nav_msgs/msg/Odometry", "std_msgs/msg/Float64"

DECODE_ERRORS = (
    SerdeError,
    AssertionError,
    ValueError,
    IndexError,
    KeyError,
    TypeError,
    OverflowError,
    MemoryError,
    struct.error,
)
"""Exceptions of rosbags and numpy on bytes that are no message of the type; UnicodeDecodeError is a ValueError."""


class CdrError(ValueError):
    """Bytes that are no message of the expected type."""


@cache
def _types() -> Typestore:
    return get_typestore(Stores.ROS2_HUMBLE)  # both messages are the same in every distribution so far


def odometry(payload: bytes) -> Any:
    """Decode a ``nav_msgs/msg/Odometry``. Raises ``CdrError``, and nothing else."""
    if len(payload) > MAX_BYTES:
        raise CdrError(f"too large: {len(payload)} bytes, at most {MAX_BYTES}")
    if payload[:2] not in (LITTLE_ENDIAN, BIG_ENDIAN):
        raise CdrError("no CDR header")
    try:
        return _types().deserialize_cdr(payload, ODOMETRY)
    except DECODE_ERRORS as error:
        raise CdrError(f"no {ODOMETRY}: {error or type(error).__name__}") from None


def float64(value: float) -> bytes:
    """Encode a ``std_msgs/msg/Float64``, little-endian."""
    types = _types()
    return bytes(types.serialize_cdr(types.types[FLOAT64](data=value), FLOAT64))
