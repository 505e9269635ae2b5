"""Schema of settings structs for error texts: names of fields, expected values, and suggestions for wrong names."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any, TypeAlias

from msgspec import inspect

from ltv_mpc.errors import format_value

Type: TypeAlias = inspect.Type

Path: TypeAlias = Sequence[str | int]
"""Keys and list positions from the outermost table down: ``("thruster", "port", "arm_m")``."""


def look_up(kind: Any, table: Any, path: Path) -> tuple[Type | None, Any]:
    """Return the type and the value at a path of settings; each may be None.

    Parameters
    ----------
    kind : settings struct.
    table : settings; they select the member of a tagged union.
    path : keys and list positions.
    """
    field_type: Type | None = inspect.type_info(kind)
    for step in path:
        field_type = _step(field_type, table, step)
        table = _value(table, step)
    return _member(field_type, table), table


def field_names(kind: Type | None) -> tuple[str, ...]:
    """Return the field names of a struct type in their order, a tag first; empty for any other type."""
    if isinstance(kind, inspect.StructType):
        tag = (kind.tag_field,) if kind.tag_field else ()
        return tag + tuple(f.encode_name for f in kind.fields)
    return ()


@cache
def scalar_fields(kind: Any) -> dict[str, Type]:
    """Return all scalar fields of nested structs by dotted key, ``{"water.sd_mps": FloatType(...), ...}``."""
    return dict(_leaves(inspect.type_info(kind), ""))


def flat(table: Mapping[str, Any], under: str = "", whole: str = "") -> dict[str, Any]:
    """Return the values of nested tables by dotted key.

    Parameters
    ----------
    table : settings or results, without structs.
    under : beginning of the keys.
    whole : a table with this key is a value.
    """
    found: dict[str, Any] = {}
    for key, value in table.items():
        is_table = isinstance(value, Mapping) and whole not in value
        found |= flat(value, f"{under}{key}.", whole) if is_table else {f"{under}{key}": value}
    return found


def closest_name(name: str, names: Iterable[str]) -> str | None:
    """Return the name that was probably meant, or None.

    Upper case, ``_`` and leading ``-`` do not count, and the tables before a key may be left out: ``speed`` means
    ``run.speed``. In this order: a similar name, one that begins like this one, one that holds it.

    Parameters
    ----------
    name : wrong name.
    names : valid names.
    """
    names = sorted(names, key=len)
    for part in (_plain, _last_part):  # as it is written, then its last part alone
        given, known = part(name), dict[str, str]()
        for valid in names:
            known.setdefault(part(valid), valid)  # of equal ones the shortest
        meant = difflib.get_close_matches(given, known, n=1)
        meant = meant or [x for x in known if given and (x.startswith(given) or (len(x) > 2 and given.startswith(x)))]
        meant = meant or [x for x in known if len(given) > 3 and given in x]
        if meant:
            return known[meant[0]]
    return None


def _plain(name: str) -> str:
    return name.casefold().replace("_", "-").lstrip("-")


def _last_part(name: str) -> str:
    return re.split(r"[./]", _plain(name))[-1]


def suggestion(name: str, names: Iterable[str]) -> str:
    """Return ``; did you mean "arm_m"?``, or the valid names if none is similar.

    Parameters
    ----------
    name : wrong name.
    names : valid names.
    """
    names = list(names)
    if meant := closest_name(name, names):
        return f"; did you mean {format_value(meant)}?"
    return f"; known: {', '.join(names)}" if names else ""


def expected(kind: Type | None, value: Any = None) -> str:
    """Describe valid values: ``a number > 0 and <= 5``.

    Parameters
    ----------
    kind : type of the field.
    value : invalid value; if it is a number, only the bounds are returned.
    """
    match kind:
        case inspect.FloatType() | inspect.IntType():
            noun, numeric = (
                ("a number", (int, float)) if isinstance(kind, inspect.FloatType) else ("an integer", (int,))
            )
            bounds = _bounds(kind)
            return bounds if bounds and type(value) in numeric else f"{noun} {bounds}".rstrip()
        case inspect.BoolType():
            return "true or false"
        case inspect.StrType():
            return "a text" + ("" if not kind.min_length else f" of at least {kind.min_length} characters")
        case inspect.LiteralType():
            return " or ".join(format_value(x) for x in kind.values)
        case inspect.EnumType():
            return " or ".join(format_value(x.value) for x in kind.cls)
        case inspect.TupleType():
            return f"a list of {len(kind.item_types)}, each {expected(kind.item_types[0])}"
        case inspect.VarTupleType() | inspect.ListType():
            least, most = kind.min_length, kind.max_length
            ends = [f"at {word} {n:,}" for word, n in (("least", least), ("most", most)) if n]
            return f"a list{' of ' * bool(ends)}{' and '.join(ends)}, each {expected(kind.item_type)}"
        case inspect.StructType():
            return f"a table with {', '.join(field_names(kind))}"
        case inspect.DictType():
            return "a table"
        case inspect.UnionType():
            tags = [x.tag for x in kind.types if isinstance(x, inspect.StructType) and x.tag is not None]
            if tags:
                return f"a table whose {_tag_field(kind)} is {' or '.join(format_value(x) for x in tags)}"
            return " or ".join(expected(x) for x in kind.types if not isinstance(x, inspect.NoneType))
        case _:
            return "another type"


def is_text(kind: Type) -> bool:
    """Return True if values of this type are strings."""
    return isinstance(kind, inspect.StrType | inspect.EnumType) or (
        isinstance(kind, inspect.LiteralType) and all(isinstance(x, str) for x in kind.values)
    )


def tag_values(kind: Type | None) -> str:
    """Return the valid tags of a union of structs, ``"hold" or "line"``; empty for any other type."""
    if not isinstance(kind, inspect.UnionType):
        return ""
    return " or ".join(format_value(x.tag) for x in kind.types if isinstance(x, inspect.StructType))


def _bounds(kind: inspect.FloatType | inspect.IntType) -> str:
    words = [
        f"{sign} {bound:.15g}" if isinstance(bound, float) else f"{sign} {bound}"
        for sign, bound in ((">", kind.gt), (">=", kind.ge), ("<", kind.lt), ("<=", kind.le))
        if bound is not None
    ]
    return " and ".join(words)


def _tag_field(kind: inspect.UnionType) -> str:
    return next((x.tag_field for x in kind.types if isinstance(x, inspect.StructType) and x.tag_field), "kind")


def _member(kind: Type | None, table: Any) -> Type | None:
    """Return the member of a union that ``table`` selects."""
    if not isinstance(kind, inspect.UnionType):
        return kind
    members = [x for x in kind.types if not isinstance(x, inspect.NoneType)]
    if len(members) == 1:
        return members[0]
    tag = table.get(_tag_field(kind)) if isinstance(table, dict) else None
    return next((x for x in members if isinstance(x, inspect.StructType) and x.tag == tag), kind)


def _step(kind: Type | None, table: Any, step: str | int) -> Type | None:
    match _member(kind, table):
        case inspect.StructType() as struct if isinstance(step, str):
            return next((f.type for f in struct.fields if f.encode_name == step), None)
        case inspect.DictType() as mapping:
            return mapping.value_type
        case inspect.TupleType() as fixed if isinstance(step, int) and step < len(fixed.item_types):
            return fixed.item_types[step]
        case inspect.VarTupleType() | inspect.ListType() as several:
            return several.item_type
        case _:
            return None


def _value(table: Any, step: str | int) -> Any:
    try:
        return table[step]
    except (KeyError, IndexError, TypeError):
        return None


def _leaves(kind: Type, prefix: str) -> Iterable[tuple[str, Type]]:
    if isinstance(kind, inspect.StructType):
        for field in kind.fields:
            yield from _leaves(field.type, f"{prefix}.{field.encode_name}" if prefix else field.encode_name)
    else:
        yield prefix, kind
