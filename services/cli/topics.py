"""Command ``topics``: topics of the bus as a table, as JSON Schema, or as the pages of the protocol."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.cli.options import Json, argument, flag, invalid, option


def topics(
    topic: Annotated[str | None, argument("TOPIC", "Key of one topic: list its fields and types.")] = None,
    as_json: Json = False,
    schema: Annotated[bool, flag("--schema", "Print the JSON Schema of the topic, or of all by key.")] = False,
    write: Annotated[Path | None, option("DIR", "Write protocol.md and schemas/ into this folder.")] = None,
) -> int:
    """List the topics of the bus, or the fields of one topic.

    The list has key, message type, period, delivery, the only writer, and the readers.
    """
    if write is not None and (topic is not None or schema or as_json):
        raise invalid("option --write", "cannot act together with TOPIC, --schema or --json: it writes every topic")
    if schema and as_json:
        raise invalid("option --schema", "is JSON already: cannot act together with --json")
    if write is not None:
        return _write(write)
    from services.reporting import topics as view

    typer.echo(view.schemas(topic) if schema else view.text(topic, as_json=as_json), nl=False)
    return 0


def _write(folder: Path) -> int:
    from services.bus import protocol

    for name, text in protocol.files().items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    typer.echo(str(folder / protocol.PAGE))
    return 0
