"""Encoding of ROS 2 messages: CDR with its 4-byte header, and the hash of a type (RIHS01).

``rosbags`` has the message definitions, those of the services are below. It is pure Python; ROS is not needed.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from services.edges.edge import Refused

MAX_BYTES = 262_144
"""Largest accepted payload. An odometry message has some 720 bytes, a path of 1000 poses 80 kB."""

LITTLE_ENDIAN, BIG_ENDIAN = b"\x00\x01", b"\x00\x00"

SERVICES = {
    "std_srvs/srv/SetBool": ("bool data", "bool success\nstring message"),
    "std_srvs/srv/Trigger": ("", "bool success\nstring message"),
}
"""Request and response of each service."""

EVENT_INFO = (
    "uint8 event_type\nbuiltin_interfaces/Time stamp\nuint8[16] client_gid\nint64 sequence_number"  # service_msgs
)

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


@cache
def _types() -> Typestore:
    """Return the types of the topics, the same in every distribution so far, and those of the services.

    A service is hashed as a type of three fields: request, response, and an event of both.
    """
    types = get_typestore(Stores.ROS2_HUMBLE)
    own = get_types_from_msg(EVENT_INFO, "service_msgs/msg/ServiceEventInfo")
    for name, (request, response) in SERVICES.items():
        own |= get_types_from_msg(request, f"{name}_Request") | get_types_from_msg(response, f"{name}_Response")
        event = f"service_msgs/ServiceEventInfo info\n{name}_Request[<=1] request\n{name}_Response[<=1] response"
        own |= get_types_from_msg(event, f"{name}_Event")
        whole = f"{name}_Request request_message\n{name}_Response response_message\n{name}_Event event_message"
        own |= get_types_from_msg(whole, name)
    types.register(_with_their_names(own))
    return types


def _with_their_names(parsed: Any) -> Any:
    """Return parsed types with the names of ROS: rosbags inserts a ``msg`` into those of services."""
    if isinstance(parsed, str):
        return parsed.replace("/srv/msg/", "/srv/")
    if isinstance(parsed, dict):
        return {_with_their_names(name): _with_their_names(of) for name, of in parsed.items()}
    if isinstance(parsed, list | tuple):
        return type(parsed)(_with_their_names(one) for one in parsed)
    return parsed


def make(ros_type: str, **fields: Any) -> Any:
    """Return a message of a type. A field is a message, or a dict of its fields; what is not given is zero or empty."""
    types = _types()
    values = {name: _value(of, fields.pop(name, None)) for name, of in types.fielddefs[ros_type][1]}
    return types.types[ros_type](**values, **fields)


def _value(of: Any, given: Any) -> Any:
    """Return the value of a field of a type, which is a tuple of rosbags."""
    kind, inner = of
    if kind is Nodetype.NAME:
        return make(inner, **(given or {})) if given is None or isinstance(given, dict) else given
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) and inner[0][0] is Nodetype.NAME:
        return [_value(inner[0], one) for one in given or ()]
    if given is not None:
        return given
    if kind is Nodetype.BASE:
        return "" if inner[0] == "string" else 0
    (_, (dtype, _)), size = inner
    return np.zeros(size if kind is Nodetype.ARRAY else 0, dtype=dtype)


def decode(payload: bytes, ros_type: str) -> Any:
    """Decode a message of a type. Raises ``Refused``, and nothing else."""
    if len(payload) > MAX_BYTES:
        raise Refused(f"too large: {len(payload)} bytes, at most {MAX_BYTES}")
    if payload[:2] not in (LITTLE_ENDIAN, BIG_ENDIAN):
        raise Refused("no CDR header")
    try:
        return _types().deserialize_cdr(payload, ros_type)
    except DECODE_ERRORS as error:
        raise Refused(f"no {ros_type}: {error or type(error).__name__}") from None


def encode(message: Any) -> bytes:
    """Encode a message, little-endian."""
    return bytes(_types().serialize_cdr(message, message.__msgtype__))


@cache
def type_hash(ros_type: str) -> str:
    """Return the hash of a type, as in REP 2016."""
    return _types().hash_rihs01(ros_type)
