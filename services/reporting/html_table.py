"""Tables of the HTML pages: rows of cells, each a text or a text with its class."""

from __future__ import annotations

import html
from collections.abc import Iterable
from typing import TypeAlias

Cell: TypeAlias = str | tuple[str, str]
"""Text of a cell, or its text and its class."""

NUMBER = "number"
"""Class of a number, which stands at the right."""


def row(cells: Iterable[Cell], tag: str = "td") -> str:
    """Return a row of a table; ``tag`` is th in its head."""
    pairs = ((cell, "") if isinstance(cell, str) else cell for cell in cells)
    return "<tr>" + "".join(f'<{tag} class="{kind}">{html.escape(text)}</{tag}>' for text, kind in pairs) + "</tr>"


def table(label: str, head: Iterable[Cell], rows: str, *, frame: str = "scroll", kind: str = "sortable") -> str:
    """Return a table that scrolls in a frame of its own; ``label`` is its name for a screen reader."""
    content = f'<table class="{kind}"><thead>{row(head, "th")}</thead><tbody>{rows}</tbody></table>'
    return f'<div class="{frame}" tabindex="0" role="region" aria-label="{html.escape(label)}">{content}</div>'


def number(value: float | None, digits: int, *, signed: bool = False) -> Cell:
    """Return the cell of a figure; a dash if there is none."""
    sign = "+" if signed else ""
    return "–" if value is None else f"{value:{sign}.{digits}f}", NUMBER
