"""Pages: each begins with its question and is written in plain modern English."""

from __future__ import annotations

import re

from tests.docs.pages import NAMES, ROOT
from tests.docs.test_readability import UNIDIOMATIC

NOTES = "docs/notes/"
WITHOUT_QUESTION = ("README.md", "docs/changes.md", "docs/contributing.md")  # the last two include a file
QUESTION = re.compile(r"This page answers: [^?]*\?")

HISTORY = re.compile(
    r"\b(?:asked for (?:was|were)|previously|formerly|no longer|in earlier versions?|used to be|was added later"
    r"|has been (?:renamed|removed)|old name)\b",
    re.IGNORECASE,
)
"""Pages say what holds now. What changed is in CHANGELOG.md, what was tried is in docs/notes/."""

PAGES = [name for name in NAMES if not name.startswith(NOTES)]

NOTE = {
    **dict.fromkeys(("Question", "Method", "Result", "Decision"), r"\s*\S"),
    "Date": r" 20\d\d-\d\d",
    "Version": r" (?:Not recorded|[^*]*\b[0-9a-f]{8}\b)",
}
"""What a note has: the label of a paragraph, and how the paragraph begins."""


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def without_code(text: str) -> str:
    return re.sub(r"<!--.*?-->|```.*?```|`[^`]*`", "", text, flags=re.DOTALL)


def test_a_page_begins_with_the_question_that_it_answers() -> None:
    pages = set(PAGES) - {*WITHOUT_QUESTION, "docs/index.md"}
    begins = {page: " ".join(text_of(page).split("\n\n", 2)[1].split()) for page in pages}
    assert {page: first for page, first in begins.items() if not QUESTION.match(first)} == {}


def test_a_note_has_question_method_result_decision_date_and_version() -> None:
    for page in (name for name in NAMES if name.startswith(NOTES)):
        text = text_of(page)
        assert [label for label, begin in NOTE.items() if not re.search(rf"\*\*{label}\.\*\*{begin}", text)] == [], page


def test_a_page_has_no_unidiomatic_word_and_no_history() -> None:
    for page in (*PAGES, "CHANGELOG.md"):
        text = without_code(text_of(page))
        assert UNIDIOMATIC.findall(text) + HISTORY.findall(text) == [], page
