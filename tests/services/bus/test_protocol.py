"""Protocol page and schemas in docs/: they match the code, and are complete."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from services.bus import protocol
from services.bus.schema import fields
from services.bus.topics import TOPICS
from services.cli.app import run

DOCS = Path(__file__).resolve().parents[3] / "docs"
PAGE = protocol.page()


def test_what_is_in_docs_is_not_stale() -> None:
    """``make protocol`` mends it."""
    stale = [
        name
        for name, text in protocol.files().items()
        if not (DOCS / name).exists() or (DOCS / name).read_text(encoding="utf-8") != text
    ]
    assert stale == []
    left_over = {f"schemas/{path.name}" for path in (DOCS / "schemas").iterdir()} - set(protocol.files())
    assert left_over == set()


def test_every_message_is_on_the_page_once_with_all_its_fields() -> None:
    sections = re.split(r"^#### `", PAGE, flags=re.M)[1:]
    by_key = {section.partition("`")[0].removesuffix("/<node>"): section for section in sections}
    assert len(sections) == len(by_key) == len(TOPICS)
    for topic in TOPICS:
        own = list(fields(topic.message_type))
        listed = re.findall(r"^\| `(\w+)` \|", by_key[topic.key].partition("\n\nAn entry of")[0], flags=re.M)
        assert listed[: len(own)] == own, topic.key


def test_topics_prints_the_schema_of_one_topic_and_of_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["topics", "--schema"]) == 0
    every = json.loads(capsys.readouterr().out)
    assert list(every) == [topic.key for topic in TOPICS]
    assert run(["topics", "plan", "--schema"]) == 0
    assert json.loads(capsys.readouterr().out) == every["plan"]
    assert every["plan"] == json.loads((DOCS / "schemas" / "Plan.json").read_text())
