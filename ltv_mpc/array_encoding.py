"""Conversion of arrays to the lists that represent them on the wire, and back: NaN is null, null is NaN."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np


def to_wire(value: Any) -> Any:
    """Return a numpy array as nested lists with null for NaN, a numpy scalar as a plain number (encoder hook).

    Raises
    ------
    NotImplementedError
        If ``value`` is of any other type.
    """
    if isinstance(value, np.ndarray):
        plain = value.tolist()
        if value.dtype.kind == "f" and np.isnan(value).any():
            plain = _null_for_nan(plain)
        return plain
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"{type(value).__name__} cannot be sent on the bus")


def _null_for_nan(plain: Any) -> Any:
    if isinstance(plain, list):
        return [_null_for_nan(x) for x in plain]
    return None if plain != plain else plain


def from_wire(kind: type, value: Any) -> Any:
    """Return nested lists as a float64 array with NaN for null, or as an int64 array if ``kind`` asks for integers.

    This is a decoder hook.

    Parameters
    ----------
    kind : annotated type of the field, ``npt.NDArray[...]``.
    value : decoded value of the field.

    Raises
    ------
    ValueError
        If the rows differ in length or an entry is not a number.
    NotImplementedError
        If ``kind`` is not an array type.
    """
    if kind is not np.ndarray and getattr(kind, "__origin__", None) is not np.ndarray:
        raise NotImplementedError(f"{kind} cannot be received from the bus")
    if getattr(kind, "__args__", (None, None))[1] == np.dtype[np.int64]:
        if not isinstance(value, list) or not all(type(x) is int for x in value):
            raise ValueError("expected a list of integers")
        return np.array(value, dtype=np.int64)
    if isinstance(value, list) and _all_numbers(value):
        with contextlib.suppress(ValueError):  # rows of different lengths
            return np.array(value, dtype=np.float64)  # null becomes NaN
    raise ValueError("expected a list of numbers, rows of one length")


_NUMBERS = {int, float, type(None)}


def _all_numbers(rows: list[Any]) -> bool:
    """Return True if a list, or a list of such lists, contains only numbers and null; booleans are not numbers."""
    kinds = set(map(type, rows))
    return all(map(_all_numbers, rows)) if kinds == {list} else kinds <= _NUMBERS
