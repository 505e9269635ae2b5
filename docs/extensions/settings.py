"""Every key of a scenario and of a sensors file, with bounds, default and meaning, where a page has the marks."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import TYPE_CHECKING

import msgspec
from docstrings import comments, default
from msgspec import inspect as struct

from ltv_mpc.settings_schema import expected

if TYPE_CHECKING:
    from sphinx.application import Sphinx

MARK, SENSORS_MARK = "<!-- settings -->", "<!-- sensors -->"


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx's entry."""
    app.connect("source-read", _fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _fill(_app: Sphinx, _page: str, source: list[str]) -> None:
    if MARK in source[0]:
        from sim.scenario import Scenario

        source[0] = source[0].replace(MARK, "\n".join(tables(Scenario, ())))
    if SENSORS_MARK in source[0]:
        from ltv_mpc.localisation.sensor_config import SensorConfig

        source[0] = source[0].replace(SENSORS_MARK, "\n".join(tables(SensorConfig, ())))


def tables(kind: type[msgspec.Struct], place: tuple[str, ...], *, optional: bool = False) -> Iterator[str]:
    """Yield a section for each table of the file, each followed by the tables inside it."""
    info, said = struct.type_info(kind), comments(kind)
    assert isinstance(info, struct.StructType)
    inner = {field.name: part for field in info.fields if (part := table(field.type)) is not None}
    may_lack = {field.name for field in info.fields if field.default is None}
    own = [field for field in info.fields if field.name not in inner and field.name != "made_by"]
    if place:
        yield f"## `[{'.'.join(place)}]`\n"
        yield f"{markdown(inspect.cleandoc(kind.__doc__ or ''))}{' *This table is optional.*' if optional else ''}\n"
    if own:
        yield "| key | must be | default | |\n|---|---|---|---|"
        for field in own:
            cells = (f"`{field.name}`", markdown(expected(field.type)), default(field).replace("``", "`"))
            yield f"| {' | '.join((*cells, markdown(said.get(field.name, ''))))} |"
        yield ""
    for name, part in inner.items():
        yield from tables(part, (*place, name), optional=name in may_lack)


def table(kind: struct.Type) -> type[msgspec.Struct] | None:
    """Return the struct type of a field, optional or not; None if it is no struct."""
    if isinstance(kind, struct.UnionType):
        return next((found for part in kind.types if (found := table(part)) is not None), None)
    return kind.cls if isinstance(kind, struct.StructType) else None


def markdown(words: str) -> str:
    """Prose in which a star, a bracket and a bar are themselves."""
    text = words.replace("``", "`")
    parts = text.split("`")
    plain = [part if i % 2 else part.translate({ord(c): f"\\{c}" for c in "*_<[|"}) for i, part in enumerate(parts)]
    return "`".join(plain)
