"""Generator of ``docs/protocol.md`` and ``docs/schemas``: prose from ``protocol_page.txt``, tables from the code.

A line ``{{name}}`` in the prose is replaced by a table: ``{{header}}``, ``{{fields KEY}}`` (the message on that key),
``{{part NAME}}`` (a struct inside a message), ``{{topics}}`` (the topics that have a table of fields), ``{{rest}}``
(all others: a line each, with the schema). ``{{most}}`` is a limit inside a sentence. ``make protocol`` writes the
files; a test fails if one differs.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from inspect import cleandoc
from pathlib import Path

from ltv_mpc import messages
from services.bus.schema import Field, fields, schema, unit, words
from services.bus.topics import BY_KEY, TOPICS, Topic
from services.bus.wire import MAX_PAYLOAD_BYTES, Header

DOCS = Path(__file__).resolve().parents[1]
PAGE = "protocol.md"
SCHEMAS = "schemas"
HEAD = ("key", "period", "written by")
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
    prose = Path(__file__).with_suffix(".txt").read_text(encoding="utf-8")
    named = re.findall(r"\{\{fields ([\w/]+)\}\}", prose)
    return re.sub(r"\{\{(\w+) ?([\w/]*)\}\}", lambda match: _table(match[1], match[2], named), prose)


def _table(name: str, argument: str, named: Iterable[str]) -> str:
    match name:
        case "topics":
            rows = [(*_row(t, f"#{_key(t)}"), _who(t.read_by)) for t in TOPICS if t.key in named]
            return _markdown((*HEAD, "read by"), rows)
        case "rest":
            rest = [topic for topic in TOPICS if topic.key not in named]
            return _markdown(
                (*HEAD, "content"), [(*_row(t, _schema(t)), re.split(r"\.(?:\s|$)", _about(t))[0]) for t in rest]
            )
        case "header":
            return _fields(fields(Header))
        case "fields":
            topic = BY_KEY[argument]
            table = _fields(fields(topic.message_type))
            return f"### `{_key(topic)}`\n\n{_about(topic)} [Schema]({_schema(topic)})\n\n{table}"
        case "part":
            return _fields(fields(getattr(messages, argument)))
        case "most":
            return f"{MAX_PAYLOAD_BYTES:,}"
    raise ValueError(f"{name}: no such table")


def _row(topic: Topic, link: str) -> tuple[str, ...]:
    return f"[`{_key(topic)}`]({link})", _rate(topic), _who((topic.written_by,))


def _schema(topic: Topic) -> str:
    return f"{SCHEMAS}/{topic.message_type.__name__}.json"


def _about(topic: Topic) -> str:
    first = cleandoc(topic.message_type.__doc__ or "").partition("\n\n")[0]
    return first.replace("``", "`").replace("\n", " ")


def _key(topic: Topic) -> str:
    return f"{topic.key}/<node>" if topic.written_by == "*" else topic.key


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
            "; ".join(filter(None, (words(field.value), unit(field), "" if field.required else "optional"))),
            field.value.get("description", ""),
        )
        for name, field in entries.items()
    ]
    return _markdown(("field", "type; unit, bounds", "meaning"), rows)


def _markdown(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', BAR) for cell in line)} |" for line in lines)


def main() -> None:
    """Write every file."""
    for name, text in files().items():
        (DOCS / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
