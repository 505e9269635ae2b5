"""Wire format: one message as a msgpack map, first the header's fields, then the message's, with units in their names.

``to_map`` converts a message to a map of builtins, which a recording holds as JSON, and ``pack`` to bytes. Decoding
rejects unknown, missing and mistyped fields and numbers out of bounds, and then validates the message as a whole
(``ltv_mpc/validation.py``). For any bytes ``decode`` either returns a message that a node can use or raises
``WireError`` with the reason.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeAlias, TypeVar

import msgpack
import msgspec
from msgspec import Meta

from ltv_mpc.array_encoding import from_wire, to_wire
from ltv_mpc.errors import format_value
from ltv_mpc.messages import Count, Message, MonotonicTime
from ltv_mpc.validation import rejection_reason
from services.bus.topics import Topic

S = TypeVar("S", bound=Message)
T = TypeVar("T")

MAX_PAYLOAD_BYTES = 1 << 20
"""Largest frame; a larger one is rejected undecoded. The largest message, an estimate with its profile, has 10 kB."""

Epoch: TypeAlias = Annotated[int, Meta(ge=0, le=2**48 - 1, extra={"unit": "identifier"})]

DECODE_ERRORS = (ValueError, TypeError, ArithmeticError, LookupError, RecursionError, msgpack.UnpackException)
"""Exceptions of msgpack, msgspec and numpy on hostile bytes; UnicodeDecodeError and ValidationError are ValueErrors."""


class Header(msgspec.Struct, frozen=True, kw_only=True):
    """Header of a message: its source and its place among the source's messages."""

    epoch: Epoch
    """identifies one start of the sender: 48 random bits"""
    sequence: Count
    """number of the message of this key and epoch, from 0 without a gap"""
    sent_monotonic_us: MonotonicTime = 0
    """the sender's CLOCK_MONOTONIC at publication; 0 or left out: unknown"""


class WireError(ValueError):
    """Rejection of a frame; the text is the reason."""


def to_map(message: Message, header: Header) -> dict[str, Any]:
    """Return header and message as one map of builtins: numbers, text, lists, maps, null."""
    plain_map: dict[str, Any] = msgspec.structs.asdict(header)
    plain_map.update(msgspec.to_builtins(message, enc_hook=to_wire))
    if plain_map["epoch"] != header.epoch:
        raise ValueError(f"a record of epoch {plain_map['epoch']} cannot be sent by epoch {header.epoch}")
    return plain_map


def encode(message: Message, header: Header) -> bytes:
    """Return the frame of a message."""
    return pack(to_map(message, header))


def pack(plain_map: Mapping[str, Any]) -> bytes:
    """Return the frame of a map from ``to_map``."""
    payload: bytes = msgpack.packb(plain_map)
    return payload


def decode(kind: type[S], payload: bytes) -> tuple[S, Header]:
    """Return message and header of a frame. Raises ``WireError``, and nothing else."""
    return from_map(kind, unpack(payload))


def from_map(kind: type[S], plain_map: dict[str, Any]) -> tuple[S, Header]:
    """Return message and header of a map from ``unpack`` or from a recording's JSON.

    Raises ``WireError``, and nothing else.
    """
    header = header_of(plain_map)
    message = _checked(_converted_message, kind, plain_map)
    reason = _checked(rejection_reason, message)
    if reason is not None:
        raise WireError(reason)
    return message, header


def message_at(topic: Topic, key: str, plain_map: dict[str, Any]) -> tuple[Message, Header]:
    """Return message and header of a map on a key. Raises ``WireError`` if it is invalid or names another node."""
    message, header = from_map(topic.message_type, plain_map)
    node = key.rpartition("/")[2]
    if topic.written_by == "*" and (named := getattr(message, "node", node)) != node:
        raise WireError(f"node = {format_value(named)}: published on the key of {node}")
    return message, header


def from_validated_map(kind: type[S], plain_map: dict[str, Any]) -> S:
    """Return the message of a map that has been accepted before, without another validation. Raises ``WireError``."""
    message: S = _checked(_converted_message, kind, plain_map)
    return message


def unpack(payload: bytes) -> dict[str, Any]:
    """Return the untyped map of a frame, for the recorder. Raises ``WireError``."""
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise WireError(f"too large: {len(payload)} bytes, at most {MAX_PAYLOAD_BYTES}")
    plain_map = _checked(msgpack.unpackb, payload)
    if not isinstance(plain_map, dict):
        raise WireError("not a map")
    return plain_map


def header_of(plain_map: dict[str, Any]) -> Header:
    """Return the header of a map from ``unpack``, within its bounds. Raises ``WireError``, and nothing else."""
    header: Header = _checked(_converted, plain_map, Header)
    return header


_EPOCH = b"\xa5epoch"
_INTEGER_BYTES = {0xCC: 1, 0xCD: 2, 0xCE: 4, 0xCF: 8, 0xD0: 1, 0xD1: 2, 0xD2: 4, 0xD3: 8}
"""Length of msgpack's integers by their first byte."""


def epoch_of(payload: bytes) -> int | None:
    """Return the first epoch in a frame without decoding it; None if there is none in its first 256 bytes."""
    at = payload.find(_EPOCH, 0, 256) + len(_EPOCH)
    if at < len(_EPOCH) or at >= len(payload):
        return None
    length = _INTEGER_BYTES.get(payload[at])
    if length is None:
        return payload[at]
    return int.from_bytes(payload[at + 1 : at + 1 + length], "big")


def crc(payload: bytes) -> int:
    """Return the CRC-32 of a frame, by which a step record identifies it."""
    return zlib.crc32(payload)


def _checked(function: Callable[..., T], *args: object) -> T:
    try:
        return function(*args)
    except DECODE_ERRORS as error:
        raise WireError((str(error) or type(error).__name__)[:200]) from None


HEADER_FIELDS = Header.__struct_fields__


def _converted_message(kind: type[S], plain_map: dict[str, Any]) -> S:
    # A StepRecord has an ``epoch`` of its own. It is its sender's, so one entry of the map holds both.
    own = plain_map.copy()
    for name in HEADER_FIELDS:
        if name not in kind.__struct_fields__:
            own.pop(name, None)
    return _converted(own, kind)


def _converted(plain_map: dict[str, Any], kind: type[T]) -> T:
    try:
        return msgspec.convert(plain_map, kind, dec_hook=from_wire)
    except msgspec.ValidationError as error:
        raise WireError(_with_value(str(error), plain_map)) from None


_AT = re.compile(r" - at `\$\.?(.*)`$")
_STEP = re.compile(r"(\w+)|\[(\d+)\]")


def _with_value(text: str, plain_map: Any) -> str:
    """Return msgspec's reason as ``field = value: reason``, the value only where it is a number."""
    match = _AT.search(text)
    if match is None:
        return text
    field = match[1]
    value = plain_map
    try:
        for name, index in _STEP.findall(field):
            value = value[name or int(index)]
    except (LookupError, TypeError):  # an entry of a map has no place in msgspec's path
        value = None
    reason = text[: match.start()]
    return f"{field} = {value}: {reason}" if isinstance(value, int | float) else f"{field}: {reason}"
