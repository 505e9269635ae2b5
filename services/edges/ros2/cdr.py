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

RESULT = "bool success\nstring message"
SERVICES = {
    "std_srvs/srv/SetBool": ("bool data", RESULT, "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a"),
    "std_srvs/srv/Trigger": ("", RESULT, "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"),
}
"""Request, response and hash of each service. The hash is that of a type with an event too: it is written down."""

DECODE_ERRORS = SerdeError, AssertionError, ValueError, LookupError, TypeError, OverflowError, MemoryError, struct.error
"""Exceptions of rosbags and numpy on bytes that are no message of the type; UnicodeDecodeError is a ValueError."""


@cache
def _types() -> Typestore:
    """Return the types of the topics, the same in every distribution so far, and those of the services."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    for name, (request, response, _) in SERVICES.items():
        for part, text in (("Request", request), ("Response", response)):
            types.register(get_types_from_msg(text, _registered(f"{name}_{part}")))
    return types


def _registered(ros_type: str) -> str:
    """Return the name of a type in the store of rosbags, which knows messages alone."""
    return ros_type.replace("/srv/", "/msg/")


def make(ros_type: str, **fields: Any) -> Any:
    """Return a message of a type. A field is a message, or a dict of its fields; what is not given is zero or empty."""
    types, name = _types(), _registered(ros_type)
    values = {field: _value(of, fields.pop(field, None)) for field, of in types.fielddefs[name][1]}
    return types.types[name](**values, **fields)


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
        return _types().deserialize_cdr(payload, _registered(ros_type))
    except DECODE_ERRORS as error:
        raise Refused(f"no {ros_type}: {error or type(error).__name__}") from None


def encode(message: Any) -> bytes:
    """Encode a message, little-endian."""
    return bytes(_types().serialize_cdr(message, message.__msgtype__))


@cache
def type_hash(ros_type: str) -> str:
    """Return the hash of a type, as in REP 2016."""
    return f"RIHS01_{SERVICES[ros_type][2]}" if ros_type in SERVICES else _types().hash_rihs01(ros_type)
