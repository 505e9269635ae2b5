"""Docstrings as the code has them, for autodoc: plain text with ``code`` and indented equations, tables of fields.

The docstrings are prose that is read in an editor first: ``|F|`` and ``x*`` mean what they say, and are no markup. Of
a struct the signature is left out; its fields stand in a table with their types, bounds, defaults and the comments
beside them in the source.
"""

from __future__ import annotations

import ast
import dataclasses
import enum
import inspect
import io
import re
import textwrap
import tokenize
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import msgspec
from msgspec import inspect as struct

from ltv_mpc.messages import Message
from ltv_mpc.settings_schema import expected
from services.bus import schema
from services.bus.schema import unit, words

if TYPE_CHECKING:
    from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx's entry."""
    app.connect("autodoc-process-docstring", _docstring)
    app.connect("autodoc-process-signature", _signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _docstring(_app: Sphinx, _what: str, _name: str, thing: object, _options: object, lines: list[str]) -> None:
    lines[:] = [*text(lines), *text(constructor(thing).splitlines())]
    if isinstance(thing, type) and issubclass(thing, msgspec.Struct):
        lines += ["", *table(*_fields(thing))]
    elif isinstance(thing, type) and issubclass(thing, enum.Enum):
        said = comments(thing)
        lines += ["", *table(("value", ""), [(literal(x.value), escaped(said.get(x.name, ""))) for x in thing])]
    elif isinstance(thing, type) and (
        hasattr(thing, "_fields") or dataclasses.is_dataclass(thing)
    ):  # their types are in the signature
        said = comments(thing)
        lines += ["", *table(("field", ""), [(literal(name), escaped(text)) for name, text in said.items()])]


def constructor(thing: object) -> str:
    """Return the docstring of a class's own constructor, which describes the parameters of the class; or ""."""
    own = vars(thing).get("__init__") if isinstance(thing, type) else None
    return inspect.cleandoc(getattr(own, "__doc__", None) or "")


def _signature(
    _app: Sphinx, _what: str, _name: str, thing: object, _options: object, _signature: str, _returns: str
) -> tuple[str, str] | None:
    has_table = isinstance(thing, type) and issubclass(thing, (msgspec.Struct, enum.Enum))
    return ("", "") if has_table or getattr(thing, "_is_protocol", False) else None


# --- text -------------------------------------------------------------------------------------------------------------


def text(lines: Iterable[str]) -> list[str]:
    """Convert a docstring's lines to reStructuredText: paragraphs as text, indented blocks literally."""
    made: list[str] = []
    for paragraph in re.split(r"\n\s*\n", textwrap.dedent("\n".join(lines)).strip("\n")):
        if re.match(r"\w+\n-{3,}\n", paragraph):
            made += section(paragraph)
        elif paragraph.startswith(" "):
            made += ["::", "", *textwrap.indent(textwrap.dedent(paragraph), "   ").splitlines(), ""]
        else:
            made += [*escaped(paragraph).splitlines(), ""]
    return made


def section(paragraph: str) -> list[str]:
    """Return a numpydoc section (Parameters, Returns, Raises) as its title and a list.

    An entry is ``name : description``, or a sentence; further lines are indented.
    """
    title, _, *lines = paragraph.splitlines()
    made = [f"**{title}**", ""]
    body = "\n".join(lines)
    is_sentence = title == "Returns" and " : " not in body
    for entry in [body] if is_sentence else re.split(r"\n(?! )", body):
        first, _, further = entry.partition("\n")
        name, separator, description = first.partition(" : ")
        if is_sentence or not (separator or re.fullmatch(r"\w+", name)):
            made.append(f"* {escaped(' '.join(entry.split()))}")
            continue
        description = f"{description} {further}"
        made.append(f"* {literal(name.strip())}: {escaped(' '.join(description.split()))}")
    return [*made, ""]


def escaped(words: str) -> str:
    """Prose, in which `code` and ``code`` are literals, a page is a link and no other character means anything."""
    parts = re.split(r"(``.+?``|`.+?`)", words, flags=re.DOTALL)
    plain = [re.sub(r"([\\*|_`<>])", r"\\\1", part) for part in parts]
    linked = [re.sub(r"\bdocs/([\w/-]+)\.md\b", r":doc:`/\1`", part) for part in plain]
    return "".join(literal(part.strip("`")) if i % 2 else linked[i] for i, part in enumerate(parts))


def literal(words: object) -> str:
    """``code``."""
    return f"``{words}``"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Yield a table, cell by cell."""
    made = [".. list-table::", "   :header-rows: 1", ""]
    for row in (head, *rows):
        for i, cell in enumerate(row):
            made.append(f"   {'*' if i == 0 else ' '} - {' '.join(cell.split())}")
    return [*made, ""]


# --- fields -----------------------------------------------------------------------------------------------------------


def _fields(kind: type[msgspec.Struct]) -> tuple[Sequence[str], list[Sequence[str]]]:
    """Of a message what the protocol says of it; of settings bounds, default and the comment in the source."""
    if issubclass(kind, Message) or kind.__module__ == Message.__module__:
        return ("field", "type", "unit, bounds", ""), [
            (
                literal(name),
                escaped(words(field.value) + ("" if field.required else ", may be left out")),
                escaped(unit(field)),
                escaped(field.value.get("description", "")),
            )
            for name, field in schema.fields(kind).items()
        ]
    said, info = comments(kind), struct.type_info(kind)
    assert isinstance(info, struct.StructType)
    return ("field", "what it must be", "default", ""), [
        (literal(field.name), escaped(expected(field.type)), default(field), escaped(said.get(field.name, "")))
        for field in info.fields
    ]


def default(field: struct.Field) -> str:
    """Return the text of a field's default: ``required`` without one, ``none`` if it may be left out."""
    value = field.default
    if field.required:
        return "required"
    if value is msgspec.NODEFAULT or isinstance(value, msgspec.Struct):
        return "of its fields"
    return "none" if value is None or value == "" else literal(str(value).lower() if isinstance(value, bool) else value)


def comments(kind: type) -> dict[str, str]:
    """Return the comment beside each field of a class and of its bases."""
    found: dict[str, str] = {}
    for part in reversed(kind.__mro__):
        if part.__module__.partition(".")[0] in ("ltv_mpc", "sim"):
            found |= _comments(inspect.getsource(part))
    return found


def _comments(source: str) -> dict[str, str]:
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    beside = {
        token.start[0]: re.sub(r"^# (noqa: \w+ +)?", "", token.string)
        for token in tokens
        if token.type == tokenize.COMMENT
    }
    (body,) = ast.parse(source).body
    assert isinstance(body, ast.ClassDef)
    found = {}
    for line in body.body:
        if isinstance(line, ast.AnnAssign | ast.Assign):
            (target,) = [line.target] if isinstance(line, ast.AnnAssign) else line.targets
            if isinstance(target, ast.Name) and line.end_lineno in beside:
                found[target.id] = beside[line.end_lineno]
    return found
