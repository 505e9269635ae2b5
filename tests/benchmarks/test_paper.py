"""Figures and tables of the paper, from short runs, and their copies on the page in docs/."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from benchmarks import page_tables
from benchmarks.paper import __main__ as command
from benchmarks.paper import tables, water
from benchmarks.paper.water import Profile
from services.reporting.figures import sheet

mpl.use("Agg")

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "paper.md"
FIGURES = ROOT / "docs" / "figures"

EMPTY_PAGE = "# A page\n" + "".join(
    f"{page_tables.BEGIN.format(name=name)}\nold\n{page_tables.END}\n" for name in command.TABLES
)


DPI = 50
"""Of the pictures made here: what costs time is their pixels."""


def options(folder: Path, *more: str) -> list[str]:
    """Return options for a short run into ``folder``, which reads nothing outside the checkout."""
    (folder / "paper.md").write_text(EMPTY_PAGE)
    return [
        *("--out", str(folder / "figures"), "--runs", str(folder / "runs"), "--page", str(folder / "paper.md")),
        *("--readme", str(folder / "descent.png"), "--measured", str(folder / "currents"), "--workers", "1"),
        *("--seeds", "1", "--cycles", "10", "--duration-s", "3", "--surface-s", "1", *more),
    ]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("paper")
    (folder / "currents").mkdir()
    rows = [f"{z},{0.05 * np.sin(z / 9)},{0.03 * np.cos(z / 7)}" for z in range(2, 60, 2)]
    present = next(iter(water.FILES))
    (folder / "currents" / present).write_text("\n".join(["depth_m,v_north_mps,u_east_mps", *rows]) + "\n")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sheet, "DPI", DPI)
        with contextlib.redirect_stderr(io.StringIO()) as said:
            assert command.main(options(folder)) == 0
    (folder / "said.txt").write_text(said.getvalue())
    return folder


# --- made whole ------------------------------------------------------------------------------------------------------


# --- structure functions ---------------------------------------------------------------------------------------------


def test_the_structure_function_of_a_steady_shear_is_its_square() -> None:
    depth = np.arange(0.0, 41.0)
    shear = Profile("shear", depth, np.column_stack([0.02 * depth, 0.01 * depth]))
    lag, D = water.structure(shear)
    np.testing.assert_array_equal(lag, np.arange(1, 21))
    np.testing.assert_allclose(D, (0.02**2 + 0.01**2) / 2 * lag**2, rtol=1e-12)
    assert water.rms_difference_mps(shear, 8.0) == pytest.approx(8 * np.sqrt(2.5e-4))
    assert water.rms_difference_mps(shear, 30.0) is None


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
