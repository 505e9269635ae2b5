"""Frames of MAVLink: a datagram in frames, a frame as a message and back, signatures.

    version 2   FD length incompat compat sequence system component message(3) payload checksum [signature(13)]
    version 1   FE length sequence system component message payload checksum

``pymavlink`` has the definitions of the messages. Frames of both versions are read, version 2 is written.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from services.edges.edge import Refused

V1, V2 = 0xFE, 0xFD
MARKERS = bytes([V1]), bytes([V2])
V1_OVERHEAD, V2_OVERHEAD = 8, 12
SIGNATURE_BYTES, SIGNED = 13, 0x01

DECODE_ERRORS = (dialect.MAVError, struct.error, ValueError, IndexError, TypeError, KeyError, OverflowError)
"""Exceptions of pymavlink on bytes that are no frame; UnicodeDecodeError is a ValueError."""

COMPONENT = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER: the edge, beside a ground station with the same system number."""


def frames_of(datagram: bytes) -> Iterator[bytes]:
    """Yield the frames of a datagram; what is no frame is yielded as the last one, for the decoder to refuse."""
    at = 0
    while at < len(datagram):
        left = datagram[at:]
        if left[0] == V2 and len(left) >= V2_OVERHEAD:
            length = V2_OVERHEAD + left[1] + (SIGNATURE_BYTES if left[2] & SIGNED else 0)
        elif left[0] == V1 and len(left) >= V1_OVERHEAD:
            length = V1_OVERHEAD + left[1]
        else:
            length = len(left)
        yield left[:length]
        at += length


class Codec:
    """Encoder and decoder of one system and component. With a key every frame is signed, in both directions."""

    def __init__(self, system: int, key: bytes | None = None, *, component: int = COMPONENT, stamp: int = 0) -> None:
        """Make a codec.

        ``key``: 32 bytes; ``stamp``: units of 10 us since 2015, from which the time stamps of signatures count.
        """
        self._mav: Any = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        if key is not None:
            self._mav.signing.secret_key = key
            self._mav.signing.sign_outgoing = True
            self._mav.signing.link_id = component
            self._mav.signing.timestamp = max(stamp, 0)  # of a host whose clock is not set
        self.make = self._mav
        """Functions ``NAME_encode`` that make a message."""

    @property
    def signs(self) -> bool:
        """True with a key: a frame that is decoded is signed, and newer than those before it."""
        return self._mav.signing.secret_key is not None

    def encode(self, message: Any) -> bytes:
        """Return the frame of a message."""
        frame = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def decode(self, frame: bytes) -> Any:
        """Return the message of a frame. Raises ``Refused``, and nothing else."""
        if frame[:1] not in MARKERS:
            raise Refused("no MAVLink frame")
        stamps = self._mav.signing.stream_timestamps
        before = dict(stamps)
        try:
            message = self._mav.decode(bytearray(frame))
        except DECODE_ERRORS as error:
            stamps.clear()  # pymavlink keeps the stamp of a wrong signature too, and then refuses the right ones
            stamps.update(before)
            text = str(error)
            kind = next((kind for kind in ("signature", "CRC", "length", "header") if kind in text), "payload")
            raise Refused(f"damaged MAVLink frame, {kind}: {text}") from None
        return message
