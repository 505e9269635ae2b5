"""Generator of ``docs/protocol.md`` and of the schemas: prose from ``protocol.md`` here, tables from the code.

A line ``{{name}}`` in the prose is replaced by a table: ``{{topics}}``, ``{{header}}``, ``{{fields KEY}}`` (the
message on that key), ``{{part NAME}}`` (a struct inside a message), ``{{rest}}`` (all messages that the prose does
not name). Three names stand for limits inside a sentence.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from importlib import resources
from inspect import cleandoc

from ltv_mpc import messages
from services.bus.schema import Field, Schema, fields, schema
from services.bus.topics import BY_KEY, TOPICS, Topic
from services.bus.wire import MAX_PAYLOAD_BYTES, Header

PAGE = "protocol.md"
SCHEMAS = "schemas"
BAR = "\\|"  # inside a cell


def files() -> dict[str, str]:
    """Return the text of each generated file, by its path in the folder of documents."""
    written = {PAGE: page()}
    for topic in TOPICS:
        written[f"{SCHEMAS}/{topic.message_type.__name__}.json"] = (
            json.dumps(schema(topic.message_type), indent=2) + "\n"
        )
    return written


def page() -> str:
    """Return the protocol page."""
    prose = resources.files("services.bus").joinpath(PAGE).read_text(encoding="utf-8")
    named = re.findall(r"\{\{fields ([\w/]+)\}\}", prose)
    rest = [topic for topic in TOPICS if topic.key not in named]
    return re.sub(r"\{\{(\w+) ?([\w/]*)\}\}", lambda match: _table(match[1], match[2], rest), prose)


def _table(name: str, argument: str, rest: Iterable[Topic]) -> str:
    match name:
        case "rest":
            return "\n\n".join(map(_message, rest))
        case "topics":
            return _topics()
        case "header":
            return _fields(fields(Header))
        case "fields":
            return _message(BY_KEY[argument])
        case "part":
            kind = getattr(messages, argument)
            return f"{_about(kind)}\n\n{_fields(fields(kind))}"
        case "most":
            return f"{MAX_PAYLOAD_BYTES:,}"
    raise ValueError(f"{name}: no such table")


def _topics() -> str:
    rows = [
        (
            f"[`{_key(topic)}`](#{_anchor(topic)})",
            _rate(topic),
            topic.delivery.value,
            _who((topic.written_by,)),
            _who(topic.read_by),
        )
        for topic in TOPICS
    ]
    return _markdown(("key", "period", "delivery", "written by", "read by"), rows)


def _message(topic: Topic) -> str:
    kind = topic.message_type
    facts = f"{_rate(topic)}; {topic.delivery.value}; written by {_who((topic.written_by,))}"
    read = f", read by {_who(topic.read_by)}" if topic.read_by else ""
    link = f"[schema]({SCHEMAS}/{kind.__name__}.json)"
    return f"#### `{_key(topic)}`\n\n{_about(kind)} *{facts}{read}.* {link}\n\n{_fields(fields(kind))}"


def _about(kind: type) -> str:
    return cleandoc(kind.__doc__ or "").replace("``", "`").replace("\n", " ").replace("  ", "\n\n")


def _key(topic: Topic) -> str:
    return f"{topic.key}/<node>" if topic.written_by == "*" else topic.key


def _anchor(topic: Topic) -> str:
    """Return the anchor that GitHub derives from the heading."""
    return re.sub(r"[^a-z0-9_ -]", "", _key(topic).lower())


def _rate(topic: Topic) -> str:
    if not topic.period_ns:
        return "on events"
    milliseconds = topic.period_ns / 1e6
    return f"{milliseconds:.4g} ms" if milliseconds < 1000 else f"{milliseconds / 1000:.4g} s"


def _who(nodes: Iterable[str]) -> str:
    return ", ".join("every node" if node == "*" else node for node in nodes) or "-"


def _fields(entries: Mapping[str, Field]) -> str:
    rows = [
        (
            f"`{name}`",
            words(field.value),
            "yes" if field.required else "",
            unit(field),
            field.value.get("description", ""),
        )
        for name, field in entries.items()
    ]
    return _markdown(("field", "type", "needed", "unit, bounds", "meaning"), rows)


def unit(field: Field) -> str:
    """Return unit and bounds, as in ``m, -1e+06 to 1e+06``; empty for a field without bounded numbers."""
    if field.bounds is None:
        return ""
    return f"{field.bounds.unit}, {_bound(field.bounds.low)} to {_bound(field.bounds.high)}"


def _bound(bound: float) -> str:
    """Format a bound; limits of integers are written as powers of two."""
    for power in (48, 53, 63):
        if abs(bound) == 2**power - 1:
            return f"{'-' if bound < 0 else ''}(2^{power} - 1)"
    return f"{bound:g}"


def words(value: Schema) -> str:
    """Describe the type of a field, as in ``3 x number`` or ``list of lists of number or null``."""
    if "anyOf" in value:
        return " or ".join(words(x) for x in value["anyOf"])
    if "enum" in value:
        return " | ".join(value["enum"])
    kind = value["type"]
    if isinstance(kind, list):
        return " or ".join(kind)
    if kind == "array":
        many = f"{value['minItems']} x" if "minItems" in value else "list of"
        return f"{many} {words(value['items'])}"
    if kind == "object":
        names = [*value.get("properties", ()), *(name.strip("^$") for name in value.get("patternProperties", ()))]
        return f"map of {', '.join(names)}" if names else "map"
    return str(kind)


def _markdown(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', BAR) for cell in line)} |" for line in lines)
