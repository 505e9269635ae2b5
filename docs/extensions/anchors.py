"""Links inside the built site: each one that leads to no file or to no anchor is a warning.

viewcode links from a source page back to the reference by one package for all names of a module: that of the first
documented one. So that these links have a target, each entry has anchors with the module of its source and ``ltv_mpc``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import unescape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.application import Sphinx


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx's entry."""
    app.connect("doctree-read", _add, priority=400)  # before viewcode, which reads the module
    app.connect("build-finished", _look)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _add(_app: Sphinx, page: nodes.document) -> None:
    """Give each entry of a Python name the module of its source, and an anchor with it."""
    from sphinx.addnodes import desc_signature

    for signature in page.findall(desc_signature):
        module, name = signature.get("module"), signature.get("fullname")
        thing = getattr(import_module(module), name.partition(".")[0], None) if module else None
        source = str(getattr(thing, "__module__", ""))
        if source.startswith(("ltv_mpc", "services")):
            signature["module"] = source
            more = (f"{source}.{name}", f"ltv_mpc.{name}")
            signature["ids"] += [anchor for anchor in more if anchor not in signature["ids"]]


def _look(app: Sphinx, error: Exception | None) -> None:
    from sphinx.util import logging

    if error is None and app.builder.format == "html":
        for link in dead(Path(app.outdir)):
            logging.getLogger(__name__).warning("%s", link)


def dead(site: Path) -> Iterator[str]:
    """Yield page and address of each link inside the site that leads nowhere."""
    texts = {path.resolve(): path.read_text(encoding="utf-8") for path in site.rglob("*.html")}
    anchors = {path: set(re.findall(r'\sid="([^"]+)"', text)) for path, text in texts.items()}
    for path, text in sorted(texts.items()):
        for address in dict.fromkeys(re.findall(r'<a\b[^>]*?\shref="([^"]*)"', text)):
            link, _, anchor = unquote(unescape(address)).partition("#")
            target = (path.parent / link).resolve() if link else path
            if re.match(r"[a-z]+:", link):
                continue
            if not target.exists() or (anchor and target in anchors and anchor not in anchors[target]):
                yield f"{path.relative_to(site.resolve())}: {address} leads nowhere"
