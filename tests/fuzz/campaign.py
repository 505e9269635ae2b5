"""Frames at every reader, shared out by weight: frame ``i`` is a function of seed, target and ``i`` alone."""

from __future__ import annotations

import itertools
import random
import time
import tracemalloc
from collections.abc import Sequence
from dataclasses import dataclass, field

from tests.fuzz.targets import Target

MOST_SHOWN = 20
"""Failures that are kept of each target; all are counted."""
SAMPLED = 200
"""Each so manieth frame is taken with the memory watched, which makes it several times slower."""
MOST_MEMORY = 256 << 20
"""Bytes that one frame may cost: the largest that is read has 1 MiB, an empty list of one byte becomes 64 in Python."""


@dataclass
class Account:
    """Result of one reader. ``failed`` counts crashes, wrong values that were let in, and frames that cost too much."""

    target: str
    frames: int = 0
    accepted: int = 0
    failed: int = 0
    slowest_ms: float = 0.0
    largest_bytes: int = 0  # of memory for one frame, of those that were watched
    failures: list[str] = field(default_factory=list)


def shares(targets: Sequence[Target], frames: int) -> list[int]:
    """Return the number of frames of each target by weight, ``frames`` in all."""
    ends = itertools.accumulate((target.weight for target in targets), initial=0.0)
    total = sum(target.weight for target in targets)
    return [b - a for a, b in itertools.pairwise(round(frames * end / total) for end in ends)]


def attack(target: Target, frames: int, seed: int, *, first: int = 0) -> Account:
    """Send ``frames`` frames, from number ``first`` on, to one reader."""
    account = Account(target.name)
    for index in range(first, first + frames):
        frame = target.frame(random.Random(f"{seed} {target.name} {index}"))
        watched = index % SAMPLED == 0 or len(frame) > 100_000
        if watched:
            tracemalloc.start()
        began = time.process_time()
        failure = _failure(target, frame, account)
        if watched:
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            account.largest_bytes = max(account.largest_bytes, peak)
            failure = failure or (f"{peak} bytes of memory" if peak > MOST_MEMORY else "")
        else:
            account.slowest_ms = max(account.slowest_ms, 1e3 * (time.process_time() - began))
        account.frames += 1
        account.failed += failure != ""
        if failure and len(account.failures) < MOST_SHOWN:
            account.failures.append(f"{target.name} {index}: {failure}"[:300])
    return account


def _failure(target: Target, frame: bytes, account: Account) -> str:
    """Return what is wrong with the reader's answer to a frame; empty if nothing is."""
    try:
        value = target.take(frame)
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    if value is None:
        return ""
    account.accepted += 1
    try:
        target.check(value)
    except Exception as error:
        return f"let in: {error or type(error).__name__}"
    return ""
