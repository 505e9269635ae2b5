"""Hash of all that the machine code of a compiled function depends on: its own code, and what it names.

What a function names is followed: other compiled functions with what they name, constants, and the fields of named
tuples, also of those that only its annotations name. Comments, docstrings and places in a file do not count, nor does
the folder of the checkout. So an edit of one function makes that function and its callers compile again, and no other.
"""

from __future__ import annotations

import functools
import hashlib
import re
import sys
from collections.abc import Iterator, Mapping
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

PACKAGES = ("ltv_mpc", "sim")


def kernel_hash(function: FunctionType, options: object = None) -> str:
    """Return the hash of a function: 16 hexadecimal digits.

    Parameters
    ----------
    function : plain Python function; all that it names exists by now.
    options : how it is compiled.

    Returns
    -------
    Digits that change with the machine code; for the same compiler and processor they name it.
    """
    digest = hashlib.sha256(repr(options).encode())
    seen: set[int] = set()
    pending: list[Any] = [function]
    while pending:
        value = pending.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        own, named = (_of_class if isinstance(value, type) else _of_function)(value)
        digest.update("\n".join(own).encode())
        pending += named
    return digest.hexdigest()[:16]


@functools.cache
def _of_function(function: FunctionType) -> tuple[list[str], list[Any]]:
    """Return what a function is by itself, and the functions and classes that it names."""
    codes = list(_codes(function.__code__))
    own = [function.__module__, function.__qualname__, repr(function.__defaults__), repr(function.__kwdefaults__)]
    for code in codes:
        constants = [x for x in code.co_consts if not isinstance(x, CodeType) and x != function.__doc__]
        arguments = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        own += [code.co_code.hex(), code.co_exceptiontable.hex(), repr((constants, code.co_names, arguments))]
    names = {name for code in codes for name in code.co_names}
    names |= {word for text in function.__annotations__.values() for word in re.findall(r"\w+", str(text))}
    values = _values(names, function.__globals__)
    cells = function.__closure__ or ()
    values += [(f"cell {i}", cell.cell_contents) for i, cell in enumerate(cells)]
    return _split(own, values)


@functools.cache
def _of_class(named_tuple: type) -> tuple[list[str], list[Any]]:
    """Return the fields of a named tuple with their defaults, and the named tuples among their types."""
    words = {word for text in named_tuple.__annotations__.values() for word in re.findall(r"\w+", str(text))}
    own = [named_tuple.__qualname__, repr(named_tuple._fields), repr(named_tuple._field_defaults)]  # type: ignore[attr-defined]
    classes = _values(words, vars(sys.modules[named_tuple.__module__]))
    return _split(own, [(name, value) for name, value in classes if _is_named_tuple(value)])


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Yield a code object and those of the functions and comprehensions inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _values(names: set[str], namespace: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return the named values of a namespace, in order; a module of this project stands for those of its own names."""
    found = []
    for name in sorted(names & namespace.keys()):
        value = namespace[name]
        if not isinstance(value, ModuleType):
            found.append((name, value))
        elif value.__name__.split(".")[0] in PACKAGES:
            found += [(f"{name}.{inner}", of) for inner, of in _values(names, vars(value))]
    return found


def _split(own: list[str], values: list[tuple[str, Any]]) -> tuple[list[str], list[Any]]:
    """Return ``own`` with the constants among the values, and the functions and classes that are to be followed."""
    followed = []
    for name, value in values:
        function = getattr(value, "py_func", value)  # of a compiled function
        if isinstance(function, FunctionType) and function.__module__.split(".")[0] in PACKAGES:
            followed.append(function)
            own.append(f"{name} {getattr(value, 'targetoptions', None)!r}")
        elif _is_named_tuple(value):
            followed.append(value)
        elif isinstance(value, np.ndarray):
            own.append(f"{name} {value.dtype} {value.shape} {value.tobytes().hex()}")
        elif isinstance(value, (bool, int, float, str, tuple, type(None))):
            own.append(f"{name} {value!r}")
    return own, followed


def _is_named_tuple(value: object) -> bool:
    """Return True for a class made by ``NamedTuple``."""
    return isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")
