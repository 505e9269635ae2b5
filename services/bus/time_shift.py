"""Conversion of the times in a message from one clock to another. The name of a time is ``t_ns`` or ends with it."""

from __future__ import annotations

from functools import cache
from typing import TypeVar

import msgspec

S = TypeVar("S", bound=msgspec.Struct)


def shifted(message: S, by_ns: int) -> S:
    """Return the message with ``by_ns`` added to each of its times, also to those of the structs in it."""
    if by_ns == 0:
        return message
    changed: dict[str, object] = {}
    for name in message.__struct_fields__:
        match getattr(message, name):
            case msgspec.Struct() as part:
                changed[name] = shifted(part, by_ns)
            case (msgspec.Struct(), *_) as parts:
                changed[name] = tuple(shifted(part, by_ns) for part in parts)
            case value if value is not None and _is_time(name):
                changed[name] = value + by_ns
    return msgspec.structs.replace(message, **changed)


@cache
def _is_time(name: str) -> bool:
    return name == "t_ns" or name.endswith("_t_ns")
