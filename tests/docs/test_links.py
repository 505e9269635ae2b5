"""Every page is reachable from the first one, and every link has a target."""

from __future__ import annotations

import re

from tests.docs.pages import NAMES, ROOT, anchors, blocks, links

PAGES_OF_THE_SITE = {name.removeprefix("docs/").removesuffix(".md") for name in NAMES if name.startswith("docs/")}


def test_every_page_stands_once_in_the_navigation() -> None:
    listed = [
        line
        for page in ("docs/index.md", "docs/notes.md")
        for block in blocks(page)
        if block.language == "{toctree}"
        for line in block.text.split()
        if not line.startswith(":") and line in PAGES_OF_THE_SITE
    ]
    assert sorted(listed) == sorted(PAGES_OF_THE_SITE - {"index"})


def test_every_link_inside_the_project_leads_somewhere() -> None:
    for page, number, link in ((name, *each) for name in NAMES for each in links(name)):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = ((ROOT / page).parent / path).resolve() if path else ROOT / page
        assert target.exists(), f"{page}:{number}: {link}"
        if anchor:
            assert anchor in anchors(target.relative_to(ROOT).as_posix()), f"{page}:{number}: {link}"
