"""Protocol page and schemas in docs/: they match the code, and are complete."""

from __future__ import annotations

import json
import re
from types import ModuleType

import pytest

from services.bus.schema import fields
from services.bus.topics import BY_KEY, TOPICS
from services.cli.app import run
from tests.docs.pages import ROOT
from tests.docs.test_reference import extension

DOCS = ROOT / "docs"


@pytest.fixture
def protocol(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return extension("protocol_page", monkeypatch)


def test_what_is_in_docs_is_not_stale(protocol: ModuleType) -> None:
    """``make protocol`` mends it."""
    stale = [
        name
        for name, text in protocol.files().items()
        if not (DOCS / name).exists() or (DOCS / name).read_text(encoding="utf-8") != text
    ]
    assert stale == []
    left_over = {f"schemas/{path.name}" for path in (DOCS / "schemas").iterdir()} - set(protocol.files())
    assert left_over == set()


def test_every_message_is_on_the_page_once_and_those_of_a_vehicle_with_all_their_fields(protocol: ModuleType) -> None:
    page = protocol.page()
    rows = re.findall(r"^\| \[`([\w/]+?)(?:/<node>)?`\]\((\S+)\)", page, flags=re.M)
    assert sorted(key for key, _ in rows) == sorted(topic.key for topic in TOPICS)
    sections = {text.partition("`")[0]: text for text in re.split(r"^### `", page, flags=re.M)[1:]}
    assert {key for key, link in rows if link.startswith("#")} == set(sections)
    for key, section in sections.items():
        own = list(fields(BY_KEY[key].message_type))
        assert re.findall(r"^\| `(\w+)` \|", section, flags=re.M)[: len(own)] == own, key


def test_topics_prints_the_schema_of_one_topic_and_of_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["topics", "--schema"]) == 0
    every = json.loads(capsys.readouterr().out)
    assert list(every) == [topic.key for topic in TOPICS]
    assert run(["topics", "plan", "--schema"]) == 0
    assert json.loads(capsys.readouterr().out) == every["plan"]
    assert every["plan"] == json.loads((DOCS / "schemas" / "Plan.json").read_text())
