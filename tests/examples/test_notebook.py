"""The notebook examples/paper.py: its cells run from top to bottom, as a program and, where installed, in Jupyter."""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib import pyplot as plt

NOTEBOOK = Path(__file__).parents[2] / "examples" / "paper.py"
DURATION = re.compile(r"^DURATION_S, SEED = 200\.0, 3$", re.MULTILINE)


def shortened() -> str:
    """Return the notebook with descents of 5 s."""
    text, count = DURATION.subn("DURATION_S, SEED = 5.0, 3", NOTEBOOK.read_text(encoding="utf-8"))
    assert count == 1
    return text


def test_its_cells_run_and_draw_the_figures_of_the_paper(capsys: pytest.CaptureFixture[str]) -> None:
    mpl.use("agg")
    names: dict[str, object] = {"__name__": "notebook"}
    try:
        exec(compile(shortened(), str(NOTEBOOK), "exec"), names)
        figures = [plt.figure(number) for number in plt.get_fignums()]
    finally:
        plt.close("all")
    assert len(figures) == 7
    assert all(axes.lines for figure in figures for axes in figure.axes)
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) == 6
    assert len({row[24:] for row in rows}) >= 4, "changes but that of the solver change something"


def test_it_runs_in_jupyter() -> None:
    missing = "the extra notebook is not installed: jupytext, nbclient, ipykernel"
    jupytext, nbclient, _ = (
        pytest.importorskip(name, reason=missing) for name in ("jupytext", "nbclient", "ipykernel")
    )
    notebook = jupytext.reads(shortened(), fmt="py:percent")
    nbclient.NotebookClient(notebook, timeout=200).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 7
