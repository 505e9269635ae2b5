"""Output of ``ltv-mpc topics``: the table of topics, the fields of one message, JSON Schemas."""

from __future__ import annotations

import json
import textwrap
from inspect import cleandoc
from typing import Any

from ltv_mpc.errors import ConfigError, format_value
from ltv_mpc.messages import Message
from ltv_mpc.settings_schema import suggestion
from services.bus.schema import message, schema, unit, words
from services.bus.topics import BY_KEY, TOPICS, Topic
from services.runtime.console import WIDTH, columns


def text(key: str | None, *, as_json: bool) -> str:
    """Format all topics, or the fields of the topic at ``key``. Raises ``ConfigError`` if there is no such topic."""
    if key is None:
        rows = [_row(topic) for topic in TOPICS]
        return json.dumps(rows, indent=2) + "\n" if as_json else _table(rows)
    topic = _at(key)
    if as_json:
        fields = {name: words(field.value) for name, field in message(topic.message_type).items()}
        return json.dumps(_row(topic) | {"fields": fields}, indent=2) + "\n"
    paragraphs = cleandoc(topic.message_type.__doc__ or "").replace("``", "").split("\n\n")
    about = "\n\n".join(textwrap.fill(paragraph, WIDTH) for paragraph in paragraphs)
    return "\n".join([f"{key}: {topic.message_type.__name__}", about, "", *columns(_fields(topic.message_type))]) + "\n"


def schemas(key: str | None) -> str:
    """Return the JSON Schema of the message on ``key``, or of every topic by key. Raises ``ConfigError``."""
    found = {topic.key: schema(topic.message_type) for topic in TOPICS}
    return json.dumps(found if key is None else found[_at(key).key], indent=2) + "\n"


def _at(key: str) -> Topic:
    if key not in BY_KEY:
        raise ConfigError(f"topic {format_value(key)}", "", f"is not a topic{suggestion(key, BY_KEY)}")
    return BY_KEY[key]


def _row(topic: Topic) -> dict[str, Any]:
    return {
        "key": f"{topic.key}/<node>" if topic.written_by == "*" else topic.key,
        "message": topic.message_type.__name__,
        "period_ns": topic.period_ns,
        "written_by": "every node" if topic.written_by == "*" else topic.written_by,
        "read_by": ["every node" if reader == "*" else reader for reader in topic.read_by],
    }


def _table(rows: list[dict[str, Any]]) -> str:
    header = ("key", "message", "period", "written by", "read by")
    cells = []
    for row in rows:
        period = f"{round(row['period_ns'] / 1e6, 1):g} ms" if row["period_ns"] else "on events"
        readers = ", ".join(row["read_by"]) or "-"
        cells.append((row["key"], row["message"], period, row["written_by"], readers))
    return "\n".join(columns([header, *cells])) + "\n"


def _fields(message_type: type[Message]) -> list[tuple[str, ...]]:
    """List name, type on the bus, presence and unit of each field, the fields of the header first."""
    return [
        (name, words(field.value), "" if field.required else "optional", unit(field))
        for name, field in message(message_type).items()
    ]
