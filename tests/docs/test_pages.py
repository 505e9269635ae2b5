"""Pages: each begins with its question and is written in plain modern English."""

from __future__ import annotations

import re

import pytest

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


@pytest.mark.parametrize("page", [page for page in PAGES if page not in WITHOUT_QUESTION])
def test_a_page_begins_with_the_question_that_it_answers(page: str) -> None:
    first = " ".join(re.split(r"\n\n", text_of(page), maxsplit=2)[1].split())
    assert QUESTION.match(first) or page == "docs/index.md", f"{page} begins with: {first[:80]}"


@pytest.mark.parametrize("page", [name for name in NAMES if name.startswith(NOTES)])
def test_a_note_has_question_method_result_decision_date_and_version(page: str) -> None:
    text = text_of(page)
    assert [label for label, begin in NOTE.items() if not re.search(rf"\*\*{label}\.\*\*{begin}", text)] == []


@pytest.mark.parametrize("page", [*PAGES, "CHANGELOG.md"])
def test_a_page_has_no_unidiomatic_word_and_no_history(page: str) -> None:
    text = without_code(text_of(page))
    assert UNIDIOMATIC.findall(text) == []
    assert HISTORY.findall(text) == []
