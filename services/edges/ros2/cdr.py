"""ROS 2 messages as bytes: CDR with its 4-byte header, which is the payload that zenoh-plugin-ros2dds passes on.

The definitions of messages come with ``rosbags`` (pure Python; ROS itself is not needed).
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

MAX_BYTES = 65_536
"""An odometry message has some 720 bytes and two names of frames."""

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
"""What rosbags and numpy raise on bytes that are no message of the type; UnicodeDecodeError is a ValueError."""


class CdrError(ValueError):
    """Bytes that are no message of the type that was expected."""


@cache
def _types() -> Typestore:
    return get_typestore(Stores.ROS2_HUMBLE)  # both messages are the same in every distribution so far


def odometry(payload: bytes) -> Any:
    """A ``nav_msgs/msg/Odometry``. Raises ``CdrError``, and nothing else."""
    if len(payload) > MAX_BYTES:
        raise CdrError(f"too large: {len(payload)} bytes, at most {MAX_BYTES}")
    if payload[:2] not in (LITTLE_ENDIAN, BIG_ENDIAN):
        raise CdrError("no CDR header")
    try:
        return _types().deserialize_cdr(payload, ODOMETRY)
    except DECODE_ERRORS as error:
        raise CdrError(f"no {ODOMETRY}: {error or type(error).__name__}") from None


def float64(value: float) -> bytes:
    """A ``std_msgs/msg/Float64``, little-endian."""
    types = _types()
    return bytes(types.serialize_cdr(types.types[FLOAT64](data=value), FLOAT64))
