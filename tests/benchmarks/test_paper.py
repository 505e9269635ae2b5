"""Figures and tables of the paper, from short runs, and their copies on the page in docs/."""

from __future__ import annotations

import contextlib
import io
import re
import struct
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from benchmarks import page_tables
from benchmarks.paper import __main__ as command
from benchmarks.paper import tables, water
from benchmarks.paper.descents import RecordedDescent
from benchmarks.paper.settings import AVERAGED, README, RECORDED
from benchmarks.paper.water import Profile
from services.reporting.figures import paper, sheet
from services.run.run_config import resolve

mpl.use("Agg")
from matplotlib.image import imread

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


def test_every_figure_is_there_at_a_column_s_width_and_shows_something(made: Path) -> None:
    for one in paper.sheets([]):
        png = made / "figures" / f"{one.name}.png"
        width, height = struct.unpack(">II", png.read_bytes()[16:24])
        assert width == round(sheet.COLUMN_IN * DPI)
        assert height == round(one.height_in * DPI)
        spread = np.ptp(imread(png)[..., :3], axis=2)
        assert np.count_nonzero(spread > 0.25) > 30, one.name  # more than ink on white
        svg = (made / "runs" / f"{one.name}.svg").read_text()
        assert svg.count("<path") > 20
    assert imread(made / "descent.png").shape[1] == round(sheet.HALF_PAGE_IN * DPI)


def test_the_page_s_tables_are_those_of_figures_json_and_the_rest_stays(made: Path) -> None:
    page = (made / "paper.md").read_text()
    figures = tables.Figures.load(made / "figures" / command.FIGURES)
    assert [table.name for table in figures.tables] == list(command.TABLES)
    for table in figures.tables:
        assert page_tables.table_text(page, table.name) == table.markdown()
    assert "old" not in page
    assert page.startswith("# A page\n")


def test_each_run_is_made_as_its_row_says(made: Path) -> None:
    figures = tables.Figures.load(made / "figures" / command.FIGURES)
    by_name = {table.name: table for table in figures.tables}
    for table, variants in ((by_name["descents"], RECORDED), (by_name["seeds"], AVERAGED)):
        assert [row[0] for row in table.rows] == [variant.name for variant in variants]
    none, paper_short, paper_long, ours_short, ours_long, default = by_name["descents"].rows
    assert none[1:3] == (None, None)
    assert none[-2:] == (0.0, 0.0)
    assert [row[1:3] for row in (paper_short, paper_long)] == [(2.4, 0.4), (5.1, 0.71)]
    assert [row[1:3] for row in (ours_short, ours_long, default)] == [(2.4, 0.0), (5.1, 0.0), (13.8, 0.0)]
    cost = (made / "runs" / paper.PAPER_LONG / "config" / "controller.toml").read_text()
    assert re.search(r"^terminal_position_per_m2 = 0.0$", cost, flags=re.M)
    assert re.search(r"^terminal_velocity_s2_per_m2 = 0.0$", cost, flags=re.M)
    for row in by_name["timing"].rows:
        assert 0.0 < row[2] <= row[3] <= row[4]  # type: ignore[operator]


def test_the_readme_s_last_run_is_the_demo_and_the_others_differ_in_one_setting() -> None:
    usual = command.Options()
    *others, demo = (
        RecordedDescent(variant, Path(), usual.duration_s, usual.surface_s).run_config().files for variant in README
    )
    assert demo == resolve("demo", []).files
    for other, key in zip(others, ("lateral", "horizon_s", "horizon_s"), strict=True):
        changed = {
            line.partition(" = ")[0]
            for name, text in other.items()
            for line in set(text.splitlines()) ^ set(demo[name].splitlines())
        }
        assert changed == {key}


def test_measured_currents_that_are_not_there_are_named(made: Path) -> None:
    found, missing = water.measured(made / "currents")
    present, *absent = water.FILES
    assert [one.name for one in found] == [water.FILES[present]]
    assert [path.name for path in missing] == absent
    said = (made / "said.txt").read_text()
    assert [name for name in water.FILES if f"{made / 'currents' / name}: no such file" in said] == absent
    assert water.measured(made / "nowhere")[0] == []
    figures = tables.Figures.load(made / "figures" / command.FIGURES)
    (table,) = (table for table in figures.tables if table.name == "water")
    assert [row[0] for row in table.rows] == [f"synthetic, {water.SEEDS} seeds", water.FILES[present]]


# --- structure functions ---------------------------------------------------------------------------------------------


def test_the_structure_function_of_a_steady_shear_is_its_square() -> None:
    depth = np.arange(0.0, 41.0)
    shear = Profile("shear", depth, np.column_stack([0.02 * depth, 0.01 * depth]))
    lag, D = water.structure(shear)
    np.testing.assert_array_equal(lag, np.arange(1, 21))
    np.testing.assert_allclose(D, (0.02**2 + 0.01**2) / 2 * lag**2, rtol=1e-12)
    assert water.rms_difference_mps(shear, 8.0) == pytest.approx(8 * np.sqrt(2.5e-4))
    assert water.rms_difference_mps(shear, 30.0) is None


def test_a_coarse_profile_has_only_the_lags_that_it_has() -> None:
    depth = np.arange(8.0, 73.0, 8.0)
    lag, D = water.structure(Profile("coarse", depth, np.column_stack([depth, depth])))
    np.testing.assert_array_equal(lag, [8.0, 16.0, 24.0, 32.0])
    np.testing.assert_allclose(D, lag**2)


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


def test_every_link_of_the_page_leads_somewhere_and_every_figure_is_linked() -> None:
    links = re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", PAGE.read_text())
    for link in links:
        assert (PAGE.parent / link).is_file(), link
    assert {f"figures/{one.name}.png" for one in paper.sheets([])} <= set(links)


def test_the_committed_pictures_are_small() -> None:
    assert sum(path.stat().st_size for path in FIGURES.iterdir()) < 2_000_000


# --- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--seeds", "0"), "option --seeds: 0: must be 1 to 10000"),
        (("--cycles", "5"), "option --cycles: 5: must be 10 to 100000"),
        (("--page", "nowhere.md"), 'option --page: "nowhere.md": cannot be read'),
        (("--duration-s", "-1"), "option --duration-s: [run] duration_s = -1.0"),
        (("--surface-s", "0.5"), "option --surface-s: [run] surface_time_s = 0.5"),
    ],
)
def test_a_wrong_option_is_refused_before_anything_starts(
    more: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(options(tmp_path, *more)) == 2
    assert words in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["paper.md"]


def test_a_page_without_a_table_s_mark_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = options(tmp_path)
    (tmp_path / "paper.md").write_text(EMPTY_PAGE.replace("<!-- table water -->", ""))
    assert command.main(arguments) == 2
    assert "<!-- table water -->" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
