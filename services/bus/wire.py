"""One message as bytes: a plain msgpack map, the header's fields first, then the signal's, units in their names.

Encoding is ``plain`` (a map of builtins, which is also what a recording holds as JSON) packed with msgpack. Decoding
is typed (unknown, missing and mistyped fields are refused) and checks meaning (``ltv_mpc/admission.py``). Whatever the
bytes are, ``decode`` returns a signal that is fit for a node or raises ``WireError`` with the reason.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import msgpack
import msgspec
import numpy as np

from ltv_mpc.admission import refusal
from ltv_mpc.messages import Message, from_wire, to_wire
from ltv_mpc.ranges import Range

S = TypeVar("S", bound=Message)
T = TypeVar("T")

MAX_PAYLOAD_BYTES = 1 << 20
"""A larger frame is refused unread: the largest message, an estimate with its profile, has about 10 kB."""

MAX_EPOCH = 2**48 - 1
MAX_COUNT = 2**53 - 1  # beyond it JavaScript's numbers are not exact

HEADER_RANGES: Mapping[str, Range] = {
    "epoch": Range(0, MAX_EPOCH, "48 bits"),
    "sequence": Range(0, MAX_COUNT, "a count"),
    "sent_monotonic_us": Range(0, MAX_COUNT, "us"),
}

RUBBISH = (ValueError, TypeError, ArithmeticError, LookupError, RecursionError, msgpack.UnpackException)
"""What msgpack, msgspec and numpy raise on hostile bytes; UnicodeDecodeError and ValidationError are ValueErrors."""


class Header(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Who sent a message and which of its messages it is."""

    epoch: int  # 48 random bits for each start of a process
    sequence: int  # of this key and epoch, from 0 without a gap
    sent_monotonic_us: int = 0  # the host's CLOCK_MONOTONIC at publication; 0: not said, as in lock step


class WireError(ValueError):
    """A frame that is refused; the text is the reason."""


def plain(signal: Message, header: Header) -> dict[str, Any]:
    """Header and signal as one map of builtins: numbers, text, lists, maps, null."""
    message: dict[str, Any] = {
        "epoch": header.epoch,
        "sequence": header.sequence,
        "sent_monotonic_us": header.sent_monotonic_us,
    }
    message.update(msgspec.to_builtins(signal, enc_hook=to_wire))
    if message["epoch"] != header.epoch:
        raise ValueError(f"a record of epoch {message['epoch']} cannot be sent by epoch {header.epoch}")
    return message


def encode(signal: Message, header: Header) -> bytes:
    """The bytes that travel."""
    return packed(plain(signal, header))


def packed(message: Mapping[str, Any]) -> bytes:
    """The bytes of what ``plain`` gives."""
    payload: bytes = msgpack.packb(message)
    return payload


def decode(kind: type[S], payload: bytes) -> tuple[S, Header]:
    """The signal and its header. Raises ``WireError``, and nothing else."""
    return typed(kind, unpack(payload))


def typed(kind: type[S], message: dict[str, Any]) -> tuple[S, Header]:
    """The same of a plain map: what ``unpack`` gives, or a recording's JSON. Raises ``WireError``, and nothing else."""
    header = header_of(message)
    signal = _checked(_signal, kind, message)
    with np.errstate(all="ignore"):  # infinity over infinity in a hostile covariance is refused, and no news
        reason = _checked(refusal, signal)
    if reason is not None:
        raise WireError(reason)
    return signal, header


def admitted(kind: type[S], message: dict[str, Any]) -> S:
    """The signal of a plain map that a door has let in before: only its form is judged. Raises ``WireError``."""
    signal: S = _checked(_signal, kind, message)
    return signal


def unpack(payload: bytes) -> dict[str, Any]:
    """The map that a frame holds, untyped, for the recorder. Raises ``WireError``."""
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise WireError(f"too large: {len(payload)} bytes, at most {MAX_PAYLOAD_BYTES}")
    message = _checked(msgpack.unpackb, payload)
    if not isinstance(message, dict):
        raise WireError("not a map")
    return message


def header_of(message: dict[str, Any]) -> Header:
    """The header of what ``unpack`` gives, its ranges checked. Raises ``WireError``, and nothing else."""
    return _checked(_header, message)


def crc(payload: bytes) -> int:
    """CRC-32 of a frame, by which a step record finds it again."""
    return zlib.crc32(payload)


def _checked(function: Callable[..., T], *args: object) -> T:
    try:
        return function(*args)
    except RUBBISH as error:
        raise WireError((str(error) or type(error).__name__)[:200]) from None


HEADER_FIELDS = tuple(Header.__struct_fields__)


def _header(message: dict[str, Any]) -> Header:
    values: tuple[Any, ...] = (message.get("epoch"), message.get("sequence"), message.get("sent_monotonic_us", 0))
    for value, (name, (low, high, _)) in zip(values, HEADER_RANGES.items(), strict=True):
        if not (type(value) is int and low <= value <= high):
            raise ValueError(f"{name}: an integer from {low} to {high} is required")
    epoch, sequence, sent_monotonic_us = values
    return Header(epoch=epoch, sequence=sequence, sent_monotonic_us=sent_monotonic_us)


def _signal(kind: type[S], message: dict[str, Any]) -> S:
    # A StepRecord has an ``epoch`` of its own; it is its sender's, so one entry of the map is both.
    own = message.copy()
    for name in HEADER_FIELDS:
        if name not in kind.__struct_fields__:
            own.pop(name, None)
    return msgspec.convert(own, kind, dec_hook=from_wire)
