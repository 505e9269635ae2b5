"""Tables of the HTML pages: rows of cells, each a text or a text with its class."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import TypeAlias

Cell: TypeAlias = str | tuple[str, str]
"""Text of a cell, or its text and its class."""

NUMBER = "number"
"""Class of a number, which stands at the right."""


def row(cells: Iterable[Cell], tag: str = "td", *, numbers: bool = False) -> str:
    """Return a row of a table; ``tag`` is th in its head, with ``numbers`` all but the first cell are numbers."""
    pairs = ((cell, NUMBER if numbers and i else "") if isinstance(cell, str) else cell for i, cell in enumerate(cells))
    return "<tr>" + "".join(f'<{tag} class="{kind}">{html.escape(text)}</{tag}>' for text, kind in pairs) + "</tr>"


def table(
    label: str,
    rows: Sequence[Iterable[Cell]],
    *,
    numbers: bool = False,
    frame: str = "scroll",
    kind: str = "sortable",
) -> str:
    """Return a table that scrolls in a frame of its own; its first row is the head.

    ``label`` is its name for a screen reader. A table of texts is printed by ``console.columns``, from the same rows.
    """
    head, *others = rows
    body = "".join(row(cells, numbers=numbers) for cells in others)
    content = f'<table class="{kind}"><thead>{row(head, "th", numbers=numbers)}</thead><tbody>{body}</tbody></table>'
    return f'<div class="{frame}" tabindex="0" role="region" aria-label="{html.escape(label)}">{content}</div>'
