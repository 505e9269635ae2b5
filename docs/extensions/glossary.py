"""Links to the glossary: on each page the first use of a term leads to its entry, a heading of docs/glossary.md."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.application import Sphinx

PAGE = "glossary"
WITHOUT_LINKS = ("options", "python", "changes", "contributing")
"""Pages without links: those made from the code, and one whose words (plan, node) often mean something else."""


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx's entry."""
    app.connect("doctree-resolved", _link)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _link(app: Sphinx, page: nodes.document, name: str) -> None:
    """Replace the first use of each term in the paragraphs of a page by a link."""
    from docutils import nodes

    if name == PAGE or name in WITHOUT_LINKS:
        return
    left: dict[str, str] = {}
    for section in app.env.get_doctree(PAGE).findall(nodes.section):
        left |= {term.lower(): section["ids"][0] for term in section[0].astext().split(", ")}
    address = app.builder.get_relative_uri(name, PAGE)
    for paragraph in list(page.findall(nodes.paragraph)):
        for text in list(paragraph.findall(nodes.Text)):
            if isinstance(text.parent, nodes.paragraph):  # not in a link, a formula or code
                text.parent.replace(text, [_node(part, anchor, address) for part, anchor in split(text.astext(), left)])


def _node(text: str, anchor: str, address: str) -> nodes.Node:
    """Return a text, as a link if there is an anchor."""
    from docutils import nodes

    if not anchor:
        return nodes.Text(text)
    return nodes.reference("", text, internal=True, refuri=f"{address}#{anchor}", classes=["term"])


def split(text: str, left: dict[str, str]) -> list[tuple[str, str]]:
    """Return the parts of a text, each with the anchor of its term or without.

    ``left`` has the anchors of the terms that have no link yet. The terms of this text are removed from it.
    """
    words = "|".join(re.escape(term) for term in sorted(left, key=len, reverse=True))
    found = re.search(rf"(?<![\w-])({words})s?(?![\w-])", text, re.IGNORECASE) if left else None
    if found is None:
        return [(text, "")]
    anchor = left.pop(found[1].lower())
    return [(text[: found.start()], ""), (found[0], anchor), *split(text[found.end() :], left)]
