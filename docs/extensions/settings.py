"""Every key of a scenario, of a sensors file and of summary.json, with its meaning, where a page has the marks."""

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

MARK, SENSORS_MARK, SUMMARY_MARK = "<!-- settings -->", "<!-- sensors -->", "<!-- summary -->"


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
    if SUMMARY_MARK in source[0]:
        source[0] = source[0].replace(SUMMARY_MARK, "\n".join(results()))


ENDINGS = {
    "_N_per_s": "N/s",
    "_us": "us",
    "_m": "m",
    "_s": "s",
    "_N": "N",
    "_J": "J",
    "_fraction": "share",
    "_power": "share",
}
"""Units by the ends of names."""


def results() -> list[str]:
    """Return the table of summary.json: name, type, unit and meaning of each figure."""
    from sim.evaluation.summary import Summary

    rows = ["| figure | type | unit | |", "|---|---|---|---|"]
    for name, kind, meaning in _figures(Summary):
        parts = (*reversed(name.split(".")), "")
        unit = next((ENDINGS[end] for part in parts for end in ENDINGS if part.endswith(end)), "")
        rows.append(f"| `{name}` | {markdown(kind)} | {unit} | {markdown(meaning)} |")
    return rows


def _figures(kind: type[msgspec.Struct]) -> Iterator[tuple[str, str, str]]:
    """Yield dotted name, type and meaning of each figure; ``NAME`` stands for names that differ, ``[]`` for a list."""
    from sim.evaluation.further import METRICS

    info = struct.type_info(kind)
    assert isinstance(info, struct.StructType)
    said = {one.name: one.meaning for one in METRICS} if kind.__name__ == "Further" else comments(kind)
    for field in info.fields:
        inner, many = table(field.type), ""
        if isinstance(field.type, struct.DictType):
            inner, many = table(field.type.value_type), ".NAME"
        elif isinstance(field.type, struct.VarTupleType):
            inner, many = table(field.type.item_type), "[]"
        meaning = said.get(field.name, "")
        if inner is None:
            yield f"{field.name}{many}", "integer" if many else expected(field.type), meaning
            continue
        for below, type_, own in _figures(inner):
            yield f"{field.name}{many}.{below}", type_, "; ".join(filter(None, (meaning, own)))


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
