"""Reader of PD0 files: whole ensembles, and the bytes that belong to none.

A frame starts with 7F 7F, its length lies within the file, and the sum of its bytes modulo 65536 equals the checksum
after it. Frames are read in file order and do not overlap. All other bytes, and frames with invalid content, are losses
with offset and reason. The clock of each head must increase: of its ensembles the most that do are read.

    checksum_i = total[i + length] - total[i]  (mod 65536),   total = running sum of all bytes

So time and memory depend only on the size of the file, even if every byte starts a frame.
"""

from __future__ import annotations

import bisect
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import msgspec
import numpy as np
import numpy.typing as npt

from ltv_mpc.config import read_bytes
from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.pd0 import records
from ltv_mpc.localisation.pd0.records import HEADER, Bytes, DamagedEnsemble, Ensemble

MARK = b"\x7f\x7f"
MAX_FILE_BYTES = 1 << 26
"""Largest size of a file: three days of a glider's dives, at 150 kB for ten minutes."""

MAX_LISTED_LOSSES = 1000
"""Largest number of losses that are listed. All are counted."""

_STRIDE = 1 << 20

Sums: TypeAlias = npt.NDArray[np.uint16]
Places: TypeAlias = npt.NDArray[np.int64]


class Loss(msgspec.Struct, frozen=True):
    """Range of bytes that belongs to no ensemble."""

    offset: int
    length: int
    why: str


class Recording(NamedTuple):
    """Content of a file, in file order; at least one ensemble."""

    source: str  # name of the file in errors
    size: int  # bytes
    ensembles: tuple[Ensemble, ...]
    losses: tuple[Loss, ...]  # the first ones, MAX_LISTED_LOSSES if nothing else is given
    lost_places: int  # number of all losses
    lost_bytes: int


def read(path: str | Path) -> Recording:
    """Read the ensembles of a file.

    Raises
    ------
    ConfigError
        If the file cannot be read or contains no valid ensemble.
    """
    source = f"PD0 file {path}"
    return parse(read_bytes(Path(path), what="PD0 file", max_bytes=MAX_FILE_BYTES), source=source)


def parse(data: bytes, *, source: str, max_losses: int = MAX_LISTED_LOSSES) -> Recording:
    """Split bytes into ensembles and losses.

    Parameters
    ----------
    data : content of a file.
    source : name of the file in errors.
    max_losses : number of losses to list; all are counted.

    Raises
    ------
    ConfigError
        If there is no valid ensemble, with the offset and reason of the first loss.
    """
    u8, total = np.frombuffer(data, dtype=np.uint8), np.zeros(len(data) + 1, dtype=np.uint16)
    np.cumsum(u8, dtype=np.uint16, out=total[1:])  # wraps like the checksum
    ensembles: list[Ensemble] = []
    losses: list[Loss] = []
    places = lost = end = 0

    def add_loss(start: int, stop: int, why: str | None = None) -> None:
        """Count bytes as lost.

        Parameters
        ----------
        start, stop : offset of the first one, and of the one after the last one.
        why : reason; None: it is found from the bytes.
        """
        nonlocal places, lost
        places, lost = places + 1, lost + stop - start
        if len(losses) < max_losses:
            losses.append(Loss(start, stop - start, why or _diagnosis(data, total, start, stop)))

    for start, length in _frames(u8, total):
        if start < end:
            continue
        if start > end:
            add_loss(end, start)
        end = start + length + 2
        try:
            ensemble = records.decode(memoryview(data)[start : start + length], start)
        except DamagedEnsemble as problem:
            add_loss(start, end, str(problem))
        else:
            ensembles.append(ensemble)
    if end < len(data):
        add_loss(end, len(data))
    heads = [[k for k, of in enumerate(ensembles) if of.settings.upward == upward] for upward in (False, True)]
    kept = {head[k] for head in heads for k in increasing([ensembles[at].t_ns for at in head])}
    for k, ensemble in enumerate(ensembles):
        if k not in kept:
            add_loss(ensemble.offset, ensemble.offset + ensemble.size, "its clock does not increase")
    losses.sort(key=lambda loss: loss.offset)
    ensembles = [ensemble for k, ensemble in enumerate(ensembles) if k in kept]
    if not ensembles:
        first = losses[0] if losses else Loss(0, 0, "the file is empty")
        raise ConfigError(source, f"byte {first.offset}", f"no valid ensemble: {first.why}")
    return Recording(source, len(data), tuple(ensembles), tuple(losses), places, lost)


def increasing(stamps: Sequence[int]) -> list[int]:
    """Return the places of the most stamps that increase (Schensted 1961).

    Parameters
    ----------
    stamps : times in the order of a file, some of them wrong.
    """
    begins: list[int] = []  # of the best runs of each length: the place of the first stamp
    behind: list[int | None] = [None] * len(stamps)
    for k in reversed(range(len(stamps))):
        length = bisect.bisect_left(begins, -stamps[k], key=lambda begin: -stamps[begin])
        behind[k] = begins[length - 1] if length else None
        begins[length : length + 1] = [k]
    run: list[int] = []
    at = begins[-1] if begins else None
    while at is not None:
        run.append(at)
        at = behind[at]
    return run


def _frames(u8: Bytes, total: Sums) -> Iterator[tuple[int, int]]:
    """Iterate over offset and length, without checksum, of all byte ranges that form a frame; they may overlap."""
    size = len(u8)
    beyond = size - HEADER - 1
    for first in range(0, max(beyond, 0), _STRIDE):
        last = min(first + _STRIDE, beyond)
        at = first + np.flatnonzero((u8[first:last] == 0x7F) & (u8[first + 1 : last + 1] == 0x7F))
        length = _u16(u8, at + 2)
        whole = (length >= HEADER) & (at + length + 2 <= size)
        at, length = at[whole], length[whole]
        right = (total[at + length] - total[at]) == _u16(u8, at + length)
        yield from zip(at[right].tolist(), length[right].tolist(), strict=True)


def _u16(u8: Bytes, at: Places) -> Places:
    return u8[at].astype(np.int64) + 256 * u8[at + 1].astype(np.int64)


def _diagnosis(data: bytes, total: Sums, start: int, end: int) -> str:
    """Return the reason why the bytes from ``start`` to ``end`` are no frame."""
    mark = data.find(MARK, start, end)
    if mark < 0:
        return "no header 7F 7F"
    if mark + HEADER > len(data):
        return f"the header at byte {mark} is cut off"
    length = int.from_bytes(data[mark + 2 : mark + 4], "little")
    if length < HEADER:
        return f"the ensemble at byte {mark} has an invalid length of {length} bytes"
    if mark + length + 2 > len(data):
        return f"the ensemble at byte {mark} has {length + 2} bytes, the file ends after {len(data) - mark} of them"
    stated = int.from_bytes(data[mark + length : mark + length + 2], "little")
    found = (int(total[mark + length]) - int(total[mark])) % 2**16  # the sums wrap round
    return f"the ensemble at byte {mark} has checksum {stated:04X}, its bytes add up to {found:04X}"
