"""Figures and tables of the paper, from short runs, and their copies on the page in docs/."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks import page_tables
from benchmarks.paper import __main__ as command
from benchmarks.paper import tables, water
from benchmarks.paper.water import Profile

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "paper.md"
FIGURES = ROOT / "docs" / "figures"


# --- structure functions ---------------------------------------------------------------------------------------------


def test_the_structure_function_of_a_steady_shear_is_its_square() -> None:
    depth = np.arange(0.0, 41.0)
    shear = Profile("shear", depth, np.column_stack([0.02 * depth, 0.01 * depth]))
    lag, D = water.structure(shear)
    np.testing.assert_array_equal(lag, np.arange(1, 21))
    np.testing.assert_allclose(D, (0.02**2 + 0.01**2) / 2 * lag**2, rtol=1e-12)


def test_synthetic_currents_have_the_structure_function_of_the_model() -> None:
    """The bound of 3 standard deviations takes a few per cent of its variance."""
    profiles = [water.synthetic(seed) for seed in range(100)]
    drawn = np.array([water.structure(one)[1] for one in profiles])
    lag, _ = water.structure(profiles[0])
    near = lag <= 12.0
    np.testing.assert_allclose(drawn.mean(axis=0)[near], 0.98 * water.model(lag[near]), rtol=0.08)


# --- the page that is committed --------------------------------------------------------------------------------------


def test_the_committed_page_quotes_the_committed_tables() -> None:
    page = PAGE.read_text()
    figures = tables.Figures.load(FIGURES / command.FIGURES)
    assert [table.name for table in figures.tables] == list(command.TABLES)
    for table in figures.tables:
        assert len(table.rows) > 1
        assert page_tables.table_text(page, table.name) == table.markdown(), "make figures"


# --- bad input -------------------------------------------------------------------------------------------------------
