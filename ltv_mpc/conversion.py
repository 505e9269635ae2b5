"""Conversion of numbers where a Python program gives them: the compiled code is written for float64 and int64.

A message of the bus has exactly the types of ``messages.py`` when it is decoded. One that a program makes may hold
whole numbers, numpy scalars, and lists or arrays of another type or layout. ``exact`` distinguishes them in 1 us by a
check that is generated from the annotations, and converts the second kind within the same bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import msgspec
import numpy as np
from msgspec import inspect

from ltv_mpc.array_encoding import from_wire, to_wire
from ltv_mpc.config import split_error, toml_key
from ltv_mpc.errors import ConfigError, one_line
from ltv_mpc.validation import plain_type

S = TypeVar("S", bound=msgspec.Struct)

FLOAT64, INT64 = np.dtype(np.float64), np.dtype(np.int64)


def converted(value: S) -> S:
    """Return a struct whose numbers have the types of its annotations.

    Parameters
    ----------
    value : a message, a vehicle, settings or a reference.

    Raises
    ------
    ConfigError : a value is not a number of that type, or out of its bounds; the error names the field.
    """
    kind = type(value)
    try:
        plain = _whole(msgspec.to_builtins(value, enc_hook=_plain))
        return msgspec.convert(plain, kind, dec_hook=from_wire)
    except (ValueError, TypeError) as error:  # that of msgspec is a ValueError
        problem, path = split_error(str(error))
        raise ConfigError(kind.__name__, toml_key(path), one_line(problem)) from None


def exact(value: S) -> S:
    """Return a message as it is if its numbers have the types of its annotations; else converted.

    Parameters
    ----------
    value : a message.

    Raises
    ------
    ConfigError : as ``converted``.
    """
    return value if is_exact(type(value))(value) else converted(value)


@cache
def is_exact(kind: type[msgspec.Struct]) -> Callable[[Any], bool]:
    """Compile the check that each number of a struct has exactly the type of its annotation.

    Parameters
    ----------
    kind : type of the struct.
    """
    info = inspect.type_info(kind)
    assert isinstance(info, inspect.StructType)
    names: dict[str, Any] = {"ndarray": np.ndarray, "FLOAT64": FLOAT64, "INT64": INT64}
    tests = [_test(field.type, f"m.{field.name}", names) for field in info.fields]
    exec(f"def check(m):\n    return {' and '.join(tests)}", names)
    check: Callable[[Any], bool] = names["check"]
    return check


def _test(field_type: inspect.Type, value: str, names: dict[str, Any]) -> str:
    """Return the expression that is true if ``value`` has exactly a type."""
    match field_type:
        case inspect.Metadata(extra={"wire": _}):  # an array; compiled code needs it contiguous and writeable
            entry = plain_type(field_type)
            while isinstance(entry, inspect.ListType):
                entry = plain_type(entry.item_type)
            dtype = "INT64" if isinstance(entry, inspect.IntType) else "FLOAT64"
            return f"(type({value}) is ndarray and {value}.dtype == {dtype} and {value}.flags.carray)"
        case inspect.Metadata(type=inner):
            return _test(inner, value, names)
        case inspect.IntType() | inspect.FloatType() | inspect.BoolType():
            return f"type({value}) is {type(field_type).__name__.removesuffix('Type').lower()}"
        case inspect.UnionType(types=types):
            return f"({' or '.join(_test(member, value, names) for member in types)})"
        case inspect.NoneType():
            return f"{value} is None"
        case inspect.TupleType(item_types=items):
            inside = "".join(f" and {_test(item, f'{value}[{i}]', names)}" for i, item in enumerate(items))
            return f"(type({value}) is tuple and len({value}) == {len(items)}{inside})"
        case inspect.VarTupleType(item_type=item):
            return f"(type({value}) is tuple and all({_test(item, 'x', names)} for x in {value}))"
        case inspect.StructType(cls=cls):
            names[cls.__name__], names[f"is_{cls.__name__}"] = cls, is_exact(cls)
            return f"(type({value}) is {cls.__name__} and is_{cls.__name__}({value}))"
        case inspect.EnumType(cls=cls):
            names[cls.__name__] = cls
            return f"type({value}) is {cls.__name__}"
    return "True"


def _plain(value: Any) -> Any:
    """Return an array, or what numpy takes for one, as nested lists; a scalar as a number; else nothing that fits."""
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        return {}
    return to_wire(array) if array.ndim else array.item()


def _whole(plain: Any) -> Any:
    """Return builtins with whole floats as integers, which become floats again where the annotation says so."""
    if isinstance(plain, dict):
        return {key: _whole(inner) for key, inner in plain.items()}
    if isinstance(plain, list | tuple):
        return [_whole(inner) for inner in plain]
    return int(plain) if type(plain) is float and plain.is_integer() and str(plain) != "-0.0" else plain
