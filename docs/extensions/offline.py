"""What a browser would fetch from elsewhere: each such address in a page, a style or a script is a warning.

A link that a reader may follow is none; what counts is what loads with the page.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx


FETCHED = {
    ".html": re.compile(
        r"""<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\bsrc=["']?((?:https?:)?//[^"'\s>]+)"""
        r"""|<link\b(?=[^>]*\brel=["']?(?:stylesheet|preload|icon|preconnect|dns-prefetch|modulepreload))[^>]*?"""
        r"""\bhref=["']?((?:https?:)?//[^"'\s>]+)"""
    ),
    ".css": re.compile(r"""(?:url\(\s*["']?|@import\s+["'])((?:https?:)?//[^"')\s]+)"""),
    ".js": re.compile(r"""(?:\bfetch\(|\bimport\(|\bimportScripts\(|\.src\s*=)\s*["'`]((?:https?:)?//[^"'`]+)"""),
}


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx's entry."""
    app.connect("build-finished", _look)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _look(app: Sphinx, error: Exception | None) -> None:
    from sphinx.util import logging

    logger = logging.getLogger(__name__)
    if error is None:
        for path in sorted(Path(app.outdir).rglob("*")):
            for address in fetched(path):
                logger.warning("%s would fetch %s", path.relative_to(app.outdir), address)


def fetched(path: Path) -> Iterator[str]:
    """Addresses elsewhere that a browser loads with this file."""
    pattern = FETCHED.get(path.suffix)
    if pattern is not None and path.is_file():
        for found in pattern.finditer(path.read_text(encoding="utf-8")):
            yield next(filter(None, found.groups()))
