"""Keys, liveliness tokens and attachments of the two ROS 2 middlewares over Zenoh.

                 zenoh-plugin-ros2dds          rmw_zenoh
    key          NAME                          DOMAIN/NAME/TYPE/HASH
    token        none: the bridge has them     @ros2_lv/DOMAIN/SESSION/NODE/ENTITY/KIND/ENCLAVE/NAMESPACE/NODE_NAME,
                                               and for an endpoint /NAME/TYPE/HASH/QOS
    attachment   none                          sequence (int64), time (int64, ns), length of the gid (1 byte), gid (16)

NAME is the name of a topic or service without its first slash. Within a token each slash of a name is a ``%``. All
numbers are little-endian. The payload is CDR with its 4-byte header in both.
Source  design document of rmw_zenoh; the tests compare with zenoh-ros2-sdk and pamoja-ros2.
"""

from __future__ import annotations

import hashlib
import re
import struct
from typing import NamedTuple

from services.edges.edge import Refused
from services.edges.ros2.cdr import type_hash
from services.edges.ros2.topics import Row

ATTACHMENT = struct.Struct("<qqB16s")
GID_BYTES = 16
NODE_NAME = "ltv_mpc"


class Attachment(NamedTuple):
    """Attachment of a message: its number, the time of publication (ns), and the identifier of its publisher."""

    sequence: int
    t_ns: int
    gid: bytes

    def pack(self) -> bytes:
        """Return the 33 bytes."""
        return ATTACHMENT.pack(self.sequence, self.t_ns, GID_BYTES, self.gid)

    @classmethod
    def unpack(cls, data: bytes) -> Attachment:
        """Read an attachment. Raises ``Refused``."""
        if len(data) != ATTACHMENT.size:
            raise Refused(f"attachment: {len(data)} bytes, must be {ATTACHMENT.size}")
        sequence, t_ns, length, gid = ATTACHMENT.unpack(data)
        if length != GID_BYTES:
            raise Refused(f"attachment: a gid of {length} bytes, must be {GID_BYTES}")
        return cls(sequence, t_ns, gid)


class Bridge:
    """Names of zenoh-plugin-ros2dds."""

    def key(self, row: Row) -> str:
        """Return the key of a row."""
        return row.topic.removeprefix("/")

    def tokens(self, rows: tuple[Row, ...], session: str) -> list[str]:  # noqa: ARG002 (of the other middleware)
        """Return no token."""
        return []


class RmwZenoh:
    """Names of rmw_zenoh in one domain. Its messages have attachments."""

    def __init__(self, domain: int) -> None:
        self._domain = domain

    def key(self, row: Row) -> str:
        """Return the key of a row."""
        return f"{self._domain}/{row.topic.removeprefix('/')}/{dds_type(row.ros_type)}/{type_hash(row.ros_type)}"

    def tokens(self, rows: tuple[Row, ...], session: str) -> list[str]:
        """Return the keys of the liveliness tokens: that of the node, then one for each row.

        Parameters
        ----------
        rows : topics and services of the node.
        session : identifier of the Zenoh session.
        """

        def token(entity: int, kind: str) -> str:
            return f"@ros2_lv/{self._domain}/{session}/0/{entity}/{kind}/%/%/{NODE_NAME}"

        ends = (
            "/".join((token(at, row.direction), *(row.topic.replace("/", "%"), dds_type(row.ros_type))))
            + f"/{type_hash(row.ros_type)}/{qos(row)}"
            for at, row in enumerate(rows, start=1)
        )
        return [token(0, "NN"), *ends]


def dds_type(ros_type: str) -> str:
    """Return the name of a type in DDS: ``std_msgs::msg::dds_::String_``."""
    package, kind, name = ros_type.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def qos(row: Row) -> str:
    """Return the quality of service of a row in a token: reliable, keep last; other fields as by default.

    The fields are reliability, durability, history and depth, deadline, lifespan, liveliness.
    """
    return f":{1 if row.latched else ''}:,{1 if row.latched else 10}:,:,:,,"


def gid_of(token: str) -> bytes:
    """Return an identifier of an endpoint: a hash of its token, as rmw_zenoh's, which uses another hash."""
    return hashlib.blake2b(token.encode(), digest_size=GID_BYTES).digest()


def is_topic(name: str) -> bool:
    """Return True for the full name of a topic or service."""
    return re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", name) is not None
