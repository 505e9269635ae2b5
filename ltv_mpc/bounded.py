"""Memory of a bounded number of entries, however many there are: the one that was stored longest ago is forgotten."""

from __future__ import annotations

from typing import TypeVar

K = TypeVar("K")
V = TypeVar("V")

MOST = 64
"""Number of entries that are remembered, unless another one is given: more are sources that nobody expects."""


def remember(memory: dict[K, V], key: K, value: V, most: int = MOST) -> V | None:
    """Store a value as the last one to be forgotten, and forget the first one if there are too many.

    Parameters
    ----------
    memory : by key, the value that was stored longest ago first; changed.
    key, value : entry to store.
    most : number of entries that are remembered.

    Returns
    -------
    The value that was forgotten, if one was.
    """
    memory.pop(key, None)
    memory[key] = value
    return memory.pop(next(iter(memory))) if len(memory) > most else None
