"""Figures show what the descriptions define (series, units, limits), for a dive with known numbers."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks import sheet
from benchmarks.paper.renderer import Run, draw
from services.reporting.plots import catalogue
from services.reporting.plots.catalogue import PLOTS
from services.reporting.plots.description import Plot, Style
from services.reporting.plots.recorded import read
from tests.services.reporting import synthetic_run


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Run:
    picture = read(synthetic_run.record(tmp_path_factory.mktemp("run") / "run.mcap"))
    return Run("a dive", picture.tables, picture.values, picture.marks)


def drawn(plot: Plot, *runs: Run) -> Axes:
    axes = Figure(figsize=(sheet.COLUMN_IN, 2.0)).subplots()
    draw(axes, plot, runs)
    return axes


def said(axes: Axes) -> list[str]:
    legend = axes.get_legend()
    return [] if legend is None else [text.get_text() for text in legend.get_texts()]


@pytest.mark.parametrize("plot", PLOTS, ids=lambda plot: plot.name)
def test_a_plot_of_one_run_has_every_series_in_its_colour_and_says_its_units(plot: Plot, dive: Run) -> None:
    axes = drawn(plot, dive)
    assert (axes.get_xlabel(), axes.get_ylabel()) == (plot.x.label, plot.y.label)
    assert said(axes) == list(dict.fromkeys(one.label for one in (*plot.series, *plot.levels) if one.label))
    bands = [series for series in plot.series if series.style is Style.BAND]
    assert len(axes.patches) == len(bands)
    lines = iter(axes.lines)
    for series in plot.series:
        if series.style is Style.BAND:
            continue
        line = next(lines)
        table = dive.tables[series.table]
        assert line.get_color() == series.colour
        for found, name in zip(line.get_data(), (series.x, series.y), strict=True):
            np.testing.assert_array_equal(np.asarray(found), np.array(table[name], dtype=float))


def test_depth_grows_downwards_and_a_logarithmic_axis_is_one(dive: Run) -> None:
    top, bottom = drawn(catalogue.DEPTH, dive).get_ylim()[::-1]
    assert top < 0.0 < 4.0 < bottom
    assert drawn(catalogue.LATENCY, dive).get_yscale() == "log"


def test_gaps_stay_gaps_and_what_is_not_there_is_said() -> None:
    gap = Run("gap", {"truth": {"t_s": [0.0, 1.0, 2.0], "depth_m": [0.0, None, 2.0]}})
    (line,) = drawn(catalogue.DEPTH, gap).lines
    assert np.isnan(np.asarray(line.get_ydata(), dtype=float)[1])
    axes = drawn(catalogue.LATENCY, gap)
    assert not axes.lines
    assert [text.get_text() for text in axes.texts] == [catalogue.LATENCY.empty]
