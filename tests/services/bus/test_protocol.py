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


def test_the_command_writes_these_files_and_names_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["topics", "--write", str(tmp_path / "docs")]) == 0
    assert capsys.readouterr().out == f"{tmp_path}/docs/protocol.md\n"
    written = {str(path.relative_to(tmp_path / "docs")) for path in tmp_path.rglob("*") if path.is_file()}
    assert written == set(protocol.files())


def test_every_message_is_on_the_page_once_with_all_its_fields() -> None:
    sections = re.split(r"^#### `", PAGE, flags=re.M)[1:]
    by_key = {section.partition("`")[0].removesuffix("/<node>"): section for section in sections}
    assert len(sections) == len(by_key) == len(TOPICS)
    for topic in TOPICS:
        own = list(fields(topic.message_type))
        listed = re.findall(r"^\| `(\w+)` \|", by_key[topic.key].partition("\n\nAn entry of")[0], flags=re.M)
        assert listed[: len(own)] == own, topic.key


def test_every_table_of_a_page_is_filled_in_and_its_rows_have_one_width() -> None:
    assert "{{" not in PAGE
    for table in re.findall(r"(?:^\|.*\|\n)+", PAGE, flags=re.M):
        widths = {len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}
        assert len(widths) == 1, table


def test_every_link_leads_somewhere() -> None:
    headings = {
        re.sub(r"[^a-z0-9_ -]", "", heading.lower()).replace(" ", "-")
        for heading in re.findall(r"^#+ (.*)$", PAGE, flags=re.M)
    }
    for target in re.findall(r"\]\(([^)]+)\)", PAGE):
        if target.startswith("#"):
            assert target[1:] in headings, target
        elif not target.startswith("http"):
            assert (DOCS / target.partition("#")[0]).exists(), target


def test_topics_prints_the_schema_of_one_topic_and_of_all(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["topics", "--schema"]) == 0
    every = json.loads(capsys.readouterr().out)
    assert list(every) == [topic.key for topic in TOPICS]
    assert run(["topics", "plan", "--schema"]) == 0
    assert json.loads(capsys.readouterr().out) == every["plan"]
    assert every["plan"] == json.loads((DOCS / "schemas" / "Plan.json").read_text())


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("topics plan --write x", "option --write: cannot act together with"),
        ("topics --schema --write x", "option --write: cannot act together with"),
        ("topics --json --write x", "option --write: cannot act together with"),
        ("topics --json --schema", "option --schema: is JSON already"),
        ("topics plann --schema", 'topic "plann": is not a topic; did you mean "plan"?'),
    ],
)
def test_options_that_cannot_act_together_are_refused(line: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(line.split()) == 2
    assert says in capsys.readouterr().err
