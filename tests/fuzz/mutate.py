"""Seeded mutations of inputs: values, structures, bytes and texts, as hostile or broken senders make them."""

from __future__ import annotations

import copy
import math
import random
import re
import struct
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import msgpack

Random: TypeAlias = random.Random

VALUES: tuple[Any, ...] = (
    *(math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -0.0, 0.5, 1e20),
    *(0, 1, -1, 2**31, 2**32, 2**53, 2**53 + 1, 2**63 - 1, 2**63, 2**64 - 1, -(2**63)),
    *(None, True, False, "", "x", "nan", "0", "\0", "é" * 3, "x" * 5000, b"", b"\xff\xfe"),
    *([], {}, [[]], [None], [math.nan], [1, [2]], [[1, 2], [3]], {"": 0}, {"t_ns": 0}),
)
"""Numbers at the ends of what numbers can be, and everything that is none."""


class Raw:
    """Raw bytes in place of a value."""

    def __init__(self, data: bytes) -> None:
        self.data = data


RAW = (
    b"\xc1",  # never used
    b"\xa4\xff\xfe\xfd\xfc",  # a string that is no UTF-8
    b"\xdd\xff\xff\xff\xff",  # a list of 4 billion
    b"\xdf\xff\xff\xff\xff",  # a map of 4 billion
    b"\xdb\xff\xff\xff\xff",  # a string of 4 GB
    b"\xc6\x7f\xff\xff\xff",  # bytes, 2 GB of them
    b"\x91" * 3000 + b"\xc0",  # deep lists
    b"\x81\xa1a" * 2000 + b"\xc0",  # deep maps
    b"\xd6\xff\x00\x00\x00\x01",  # a time, by msgpack's own extension
    b"\xc7\x0c\xff" + b"\xff" * 12,  # one that no calendar has
    b"\xd4\x05\x00",  # an extension that nobody knows
    b"\xcb\x7f\xf0\x00\x00\x00\x00\x00\x01",  # a signalling NaN
    b"\xca\x7f\xc0\x00\x00",  # NaN in 32 bits
    b"\xdc\x40\x00" + b"\xc0" * 0x4000,  # 16,384 nulls
    b"\xdc\x40\x00" + b"\x90" * 0x4000,  # 16,384 empty lists
)


_PLACE = b"here stands something else"
_PACKED_PLACE: bytes = msgpack.packb(_PLACE)


def packed(tree: Any, rng: Random) -> bytes:
    """Pack as msgpack, with ``Raw`` unchanged; some maps repeat a key."""
    raws: list[bytes] = []

    def place(value: Any) -> Any:
        if not isinstance(value, Raw):  # an integer that msgpack does not know
            return float(value)
        raws.append(value.data)
        return _PLACE

    if isinstance(tree, dict) and tree and rng.random() < 0.03:
        pairs = [*tree.items(), (rng.choice(list(tree)), rng.choice(VALUES))]
        data = struct.pack(">BH", 0xDE, len(pairs))
        data += b"".join(msgpack.packb(part, default=place) for pair in pairs for part in pair)
    else:
        data = msgpack.packb(tree, default=place)
    for raw in raws:
        data = data.replace(_PACKED_PLACE, raw, 1)
    return data


def tree(rng: Random, message: Any) -> Any:
    """Return a copy with one to three faults in its structure or values."""
    message = msgpack.unpackb(msgpack.packb(message), strict_map_key=False)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        _spoil(rng, message)
    return message


def _spoil(rng: Random, place: Any) -> None:
    while place:
        key = rng.choice(list(place) if isinstance(place, dict) else range(len(place)))
        inner = place[key]
        if not isinstance(inner, dict | list) or not inner or rng.random() < 0.25:
            break
        place = inner
    else:
        return
    match rng.randrange(8):
        case 0 | 1:
            place[key] = copy.deepcopy(rng.choice(VALUES))
        case 2:
            place[key] = Raw(rng.choice(RAW))
        case 3:
            del place[key]
        case 4 if isinstance(place, list):
            place.extend([copy.deepcopy(place[key])] * rng.choice((1, 1, 2, 500)))
        case 4:
            place[rng.choice(("version", "epoch", "x" * 300, "", "t_ns"))] = copy.deepcopy(rng.choice(VALUES))
        case 5:
            place[key] = [place[key]]
        case 6:
            place[key] = near(rng, place[key])
        case _:
            other = rng.choice(list(place) if isinstance(place, dict) else range(len(place)))
            place[key], place[other] = place[other], place[key]


def near(rng: Random, value: Any) -> Any:
    """Return a similar value: wrong in sign, size or length, not in type."""
    match value:
        case bool():
            return not value
        case int() | float():
            return rng.choice((-value, value * 1e9, value + rng.choice((1, -1, 1e-9)), value * rng.uniform(-3, 3)))
        case str():
            return value[: len(value) // 2] + rng.choice(("", "\0", "`", value))
        case list() if value:
            return rng.choice((value[:-1], value + value[:1], value[::-1], [value[0]] * len(value)))
        case _:
            return copy.deepcopy(rng.choice(VALUES))


def raw(rng: Random, data: bytes) -> bytes:
    """Return bytes as a faulty link or disk changes them."""
    spoiled = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        if not spoiled:
            break
        at = rng.randrange(len(spoiled))
        match rng.randrange(6):
            case 0 | 1:
                spoiled[at] ^= 1 << rng.randrange(8)
            case 2:
                spoiled[at] = rng.choice((0, 0x7F, 0x80, 0xFF, rng.randrange(256)))
            case 3:
                del spoiled[at:]
            case 4:
                until = min(len(spoiled), at + rng.choice((1, 4, 64)))
                del spoiled[at:until]
            case _:
                until = min(len(spoiled), at + rng.choice((1, 4, 64, 1024)))
                spoiled[at:at] = spoiled[at:until] or rng.randbytes(8)
    return bytes(spoiled)


NUMBER = re.compile(rb"(?<![\w.])[-+]?\d[\d_.]*(?:e[-+]?\d+)?(?![\w.])")
NUMBERS = (
    *(b"nan", b"inf", b"-inf", b"1e999", b"-1", b"0", b"1e308", b"5e-324", b"9" * 400, b"99999999999999999999"),
    *(b"0x10", b"1_0", b"0.1.2", b"", b"true", b'"1"', b"[]", b"{}", b"[1, 2]", b"1979-05-27", b"12:00", b"1e3"),
    *(b"'''", b'"\\uD800"', b"\xff", b"\0", b"[" * 3000, b"{a=" * 500, b"[" * 200 + b"]" * 200),
)
LINES = (
    *(b"[a]", b"[[a]]", b"[a.a.a.a]", b"a" + b".a" * 2000 + b" = 1", b"[" + b"a." * 500 + b"a]", b"version = 2"),
    *(b'"" = 1', b'x = "' + b"y" * 5000 + b'"', b"\xef\xbb\xbf", b"\xff\xfe", b"\0", b"#" + b"z" * 5000, b","),
    *(b"a = " + b"[" * 100 + b"]" * 100, b"title = nan", b"kind = 'no such'", b"base = 'no such'", b"file = '../x'"),
)


def text(rng: Random, data: bytes) -> bytes:
    """Return a settings file or table with errors of an editor or of an attacker."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        data = _spoiled_text(rng, data)
    return raw(rng, data) if rng.random() < 0.1 else data


def _spoiled_text(rng: Random, data: bytes) -> bytes:
    lines = data.split(b"\n")
    at = rng.randrange(len(lines))
    match rng.randrange(7):
        case 0 | 1 | 2:
            found = list(NUMBER.finditer(data))
            if found:
                spot = rng.choice(found)
                return data[: spot.start()] + rng.choice(NUMBERS) + data[spot.end() :]
        case 3:
            lines.insert(at, rng.choice((*LINES, lines[at])))
        case 4:
            del lines[at]
        case 5:
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        case _:
            lines[at] = raw(rng, lines[at])
    return b"\n".join(lines)


def one_of(rng: Random, *ways: tuple[float, Callable[[], bytes]]) -> bytes:
    """Draw one item by weight."""
    weights: Sequence[float] = [weight for weight, _ in ways]
    (way,) = rng.choices([way for _, way in ways], weights)
    return way()
