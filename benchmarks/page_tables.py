"""Generated tables in pages of docs/, written between marks."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from ltv_mpc.errors import ConfigError

BEGIN, END = "<!-- table {name} -->", "<!-- end of table -->"


class Table(msgspec.Struct, frozen=True, kw_only=True):
    """Table of a page. ``digits``: decimals of each column; a text is printed as it is, None as a dash."""

    name: str
    head: tuple[str, ...]
    digits: tuple[int, ...]
    rows: tuple[tuple[str | float | None, ...], ...]

    def markdown(self) -> str:
        """Format the table in Markdown, with a line break at the end."""
        lines = [self.head, ("---",) * len(self.head)]
        lines += [tuple(_cell(value, n) for value, n in zip(row, self.digits, strict=True)) for row in self.rows]
        return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _cell(value: str | float | None, digits: int) -> str:
    if value is None:
        return "–"
    return value if isinstance(value, str) else f"{value:.{digits}f}"


def table_text(page: str, name: str) -> str:
    """Return the text at a table's mark in a page. Raises ``ConfigError`` if there is no such mark."""
    _, begin, rest = page.partition(BEGIN.format(name=name) + "\n")
    text, end, _ = rest.partition(END)
    if not begin or not end:
        raise ConfigError("page", BEGIN.format(name=name), f"must appear once, with {END} below it")
    return text


def replace_tables(page: str, tables: Sequence[Table]) -> str:
    """Replace the tables at their marks in the page. Raises ``ConfigError``."""
    for table in tables:
        page = page.replace(_marked(table.name, table_text(page, table.name)), _marked(table.name, table.markdown()))
    return page


def _marked(name: str, text: str) -> str:
    return f"{BEGIN.format(name=name)}\n{text}{END}"
