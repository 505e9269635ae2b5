"""Command ``topics``: topics of the bus as a table or as JSON Schema."""

from __future__ import annotations

from typing import Annotated

import typer

from services.cli.options import Json, argument, flag, invalid


def topics(
    topic: Annotated[str | None, argument("TOPIC", "Key of one topic: list its fields and types.")] = None,
    as_json: Json = False,
    schema: Annotated[bool, flag("--schema", "Print the JSON Schema of the topic, or of all by key.")] = False,
) -> int:
    """List the topics of the bus, or the fields of one topic.

    The list has key, message type, period, delivery, the only writer, and the readers.
    """
    if schema and as_json:
        raise invalid("option --schema", "is JSON already: cannot act together with --json")
    from services.reporting import topics as view

    typer.echo(view.schemas(topic) if schema else view.text(topic, as_json=as_json), nl=False)
    return 0
