"""Frames at every reader, shared out by weight; what got through is kept so that it can be sent again.

Frame ``i`` of a target is a function of seed, target and ``i`` alone.
"""

from __future__ import annotations

import gc
import itertools
import random
import resource
import time
import tracemalloc
from collections.abc import Callable, Sequence

import msgspec

from tests.fuzz.targets import Target

MOST_SHOWN = 20
"""Failures that are kept of each target; all are counted."""
SAMPLED = 200
"""Each so manieth frame is taken with the memory watched, which makes it several times slower."""
MOST_MEMORY = 256 << 20
"""Bytes that one frame may cost: the largest that is read has 1 MiB, an empty list of one byte becomes 64 in Python."""


class Failure(msgspec.Struct, frozen=True, kw_only=True):
    """Frame that a reader wrongly accepted or that made it crash."""

    target: str
    index: int
    what: str
    frame_hex: str  # at most 4 KiB of it


class OfTarget(msgspec.Struct, kw_only=True):
    """Result of one reader."""

    target: str
    frames: int = 0
    accepted: int = 0
    crashes: int = 0  # an error that is not documented
    let_in: int = 0  # a value that should not have been
    slowest_ms: float = 0.0
    largest_bytes: int = 0  # of memory for one frame, of those that were watched
    seconds: float = 0.0  # of this process's CPU


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a campaign. ``grown_bytes`` is the memory growth of the process after the first tenth."""

    frames: int
    seed: int
    accepted: int
    crashes: int
    let_in: int
    beyond_memory: int
    grown_bytes: int
    seconds: float
    targets: tuple[OfTarget, ...]
    failures: tuple[Failure, ...]

    @property
    def held(self) -> bool:
        """True if every frame was handled correctly."""
        return not (self.crashes or self.let_in or self.beyond_memory)


def run(
    targets: Sequence[Target],
    frames: int,
    seed: int,
    *,
    first: int = 0,
    told: Callable[[str, float], None] | None = None,
) -> Result:
    """Run ``frames`` frames, from index ``first`` of each target; ``told`` receives the target and the share done."""
    began = time.monotonic()
    counts = shares(targets, frames)
    accounts, failures = [], []
    beyond = 0
    early_bytes = late_bytes = 0
    for part in range(10):  # in turns, so that what one leaves behind is there when the others come
        for k, target in enumerate(targets):
            if part == 0:
                accounts.append(OfTarget(target=target.name))
            begin, end = (first + counts[k] * x // 10 for x in (part, part + 1))
            for index in range(begin, end):
                beyond += _one(target, seed, index, accounts[k], failures)
            if told is not None:
                told(target.name, (part + (k + 1) / len(targets)) / 10)
        gc.collect()
        late_bytes = _resident_bytes()
        early_bytes = early_bytes or late_bytes
    return Result(
        frames=sum(account.frames for account in accounts),
        seed=seed,
        accepted=sum(account.accepted for account in accounts),
        crashes=sum(account.crashes for account in accounts),
        let_in=sum(account.let_in for account in accounts),
        beyond_memory=beyond,
        grown_bytes=late_bytes - early_bytes,
        seconds=time.monotonic() - began,
        targets=tuple(accounts),
        failures=tuple(failures),
    )


def shares(targets: Sequence[Target], frames: int) -> list[int]:
    """Return the number of frames of each target by weight, ``frames`` in all."""
    total = sum(target.weight for target in targets)
    ends, at = [0], 0.0
    for target in targets:
        at += target.weight
        ends.append(round(frames * at / total))
    return [b - a for a, b in itertools.pairwise(ends)]


def frame_of(target: Target, seed: int, index: int) -> bytes:
    """Return the frame of an index again."""
    return target.frame(random.Random(f"{seed} {target.name} {index}"))


def _one(target: Target, seed: int, index: int, account: OfTarget, failures: list[Failure]) -> bool:
    """Run one frame and return True if it used more memory than allowed."""
    frame = frame_of(target, seed, index)
    watched = index % SAMPLED == 0 or len(frame) > 100_000
    if watched:
        tracemalloc.start()
    began = time.process_time()
    account.frames += 1
    what = ""
    try:
        value = target.take(frame)
    except Exception as error:
        account.crashes += 1
        what = f"{type(error).__name__}: {error}"
    else:
        if value is not None:
            account.accepted += 1
            try:
                target.check(value)
            except Exception as error:
                account.let_in += 1
                what = f"let in: {error or type(error).__name__}"
    took = time.process_time() - began
    account.seconds += took
    account.slowest_ms = max(account.slowest_ms, 0.0 if watched else 1e3 * took)
    beyond = False
    if watched:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        account.largest_bytes = max(account.largest_bytes, peak)
        if peak > MOST_MEMORY:
            beyond, what = True, what or f"{peak} bytes of memory"
    if what and sum(failure.target == target.name for failure in failures) < MOST_SHOWN:
        failures.append(Failure(target=target.name, index=index, what=what[:300], frame_hex=frame[:4096].hex()))
    return beyond


def _resident_bytes() -> int:
    """Return the resident memory of this process (bytes)."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * resource.getpagesize()
