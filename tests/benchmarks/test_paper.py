"""Tables of the paper and their copies on the page in docs/."""

from __future__ import annotations

from pathlib import Path

from benchmarks import page_tables
from benchmarks.paper import __main__ as command
from benchmarks.paper import tables

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "paper.md"
FIGURES = ROOT / "docs" / "figures"


def test_the_committed_page_quotes_the_committed_tables() -> None:
    page = PAGE.read_text()
    figures = tables.Figures.load(FIGURES / command.FIGURES)
    assert [table.name for table in figures.tables] == list(command.TABLES)
    for table in figures.tables:
        assert len(table.rows) > 1
        assert page_tables.table_text(page, table.name) == table.markdown(), "make figures"
