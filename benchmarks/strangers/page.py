"""Page of the strangers: the flights of all hulls under all conditions, and its text and tables."""

from __future__ import annotations

import datetime
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.batch import in_order
from benchmarks.strangers.flight import FOREIGN
from benchmarks.strangers.rival import gains_of
from benchmarks.strangers.tasks import CONDITIONS, ONLY_OURS, TASKS, Figures, fly_task, mean_figures
from services.run.provenance import provenance_table

PAGE = Path("docs/notes/strangers.md")
STARTS = 3
MAX_NAMES = 8
"""Number of cells up to which the page names each in which the rival is better."""


class Cell(NamedTuple):
    """One cell of the matrix."""

    hull: str
    condition: str
    task: str
    ours: bool


def _fly(job: tuple[Cell, int]) -> Figures:
    cell, seed = job
    return fly_task(cell.hull, cell.task, CONDITIONS[cell.condition], seed, None if cell.ours else gains_of(cell.hull))


def run(*, starts: int = STARTS, workers: int | None = None) -> dict[Cell, Figures]:
    """Fly the matrix from some starts."""
    cells = [
        Cell(hull, condition, task, ours)
        for hull in FOREIGN
        for condition in CONDITIONS
        for task in TASKS
        for ours in ((True,) if condition in ONLY_OURS else (True, False))
    ]
    jobs = [(cell, seed) for cell in cells for seed in range(1, starts + 1)]
    flown = in_order(_fly, jobs, workers=workers)
    return {cell: mean_figures(flown[i * starts : (i + 1) * starts]) for i, cell in enumerate(cells)}


def table(found: dict[Cell, Figures]) -> str:
    """Return largest errors over the tasks by condition and hull, and late cells, thrust and wrong health of all."""
    columns = (*FOREIGN, "not arrived", "mean F (%)", "wrongly nominal (%)")
    lines = ["| condition | " + " | ".join(columns) + " |", "|---" * (1 + len(columns)) + "|"]
    for condition in CONDITIONS:
        of = [(cell, figures) for cell, figures in found.items() if cell.condition == condition]
        by_side = [[(cell.hull, figures) for cell, figures in of if cell.ours == ours] for ours in (True, False)]
        sides = [_side(each) for each in by_side if each]
        wrong = f"{100 * np.mean([figures.wrongly_nominal for _, figures in by_side[0]]):.1f}"
        lines.append("| " + " | ".join((condition, *map("; ".join, zip(*sides, strict=True)), wrong)) + " |")
    return "\n".join(lines)


def _side(of: Sequence[tuple[str, Figures]]) -> list[str]:
    """Return the cells of one condition, of the controller or of the rival."""
    texts = []
    for hull in FOREIGN:
        figures = [each for name, each in of if name == hull]
        mark = "" if all(np.isfinite(each.arrival_s) for each in figures) else "!"
        texts.append(f"{max(x.mean_m for x in figures):.2f} ({max(x.max_m for x in figures):.1f}){mark}")
    late = sum(not np.isfinite(figures.arrival_s) for _, figures in of)
    force = f"{100 * np.mean([figures.force for _, figures in of]):.0f}"
    return [*texts, str(late), force]


def worse_cells(found: dict[Cell, Figures]) -> Sequence[Cell]:
    """Return our cells whose mean error is above the rival's by more than 0.1 m, or that alone do not arrive."""
    out = []
    for cell, figures in found.items():
        rival = found.get(cell._replace(ours=False))
        if cell.ours and rival is not None:
            alone_late = np.isfinite(rival.arrival_s) and not np.isfinite(figures.arrival_s)
            if alone_late or figures.mean_m > rival.mean_m + 0.1:
                out.append(cell)
    return out


def text(found: dict[Cell, Figures], starts: int = STARTS) -> str:
    """Return the page."""
    worse = worse_cells(found)
    both = sum(cell._replace(ours=False) in found for cell in found if cell.ours)
    by_hull = Counter(cell.hull for cell in worse)
    if len(worse) > MAX_NAMES:
        names = ", ".join(f"{count} of `{hull}`" for hull, count in by_hull.items())
    else:
        names = "; ".join(f"{cell.hull}, {cell.condition}, {cell.task}" for cell in worse) or "none"
    return f"""# A fleet of strangers

**Question.** Does the controller steer hulls of another structure than its model, and how well beside a usual one?

**Method.** `python -m benchmarks.strangers --write`: three hulls that share no equation with the model (80 kg catamaran
with linear drag, 70 kg ellipsoid with a Munk moment, 28 kg boat with coupled drag; sources in `benchmarks/strangers`),
each with the file of its data sheet. The rival (PID, line of sight with an integral) is tuned once a hull and reads no
reports. Tasks ({starts} starts): a point 5 m away, a line and a square of 20 m, a point 5 m astern, three points with
stays. Offset: estimates of an undeclared point 0.15 m ahead. Noise has no covariance. Side force: wind of a tenth of
the thrust. Released: thrusters rest between 20 and 50 s.

**Date.** {datetime.datetime.now(tz=datetime.UTC):%Y-%m}. **Version.** {provenance_table()["commit"][:8]}.

**Result.** Of {both} cells with a rival, the controller is worse by more than 0.1 m, or alone does not arrive, in
{len(worse)}: {names}.

Largest mean error of the five tasks and, in brackets, largest error (m), controller; rival: distance from the path
until the arrival, or from the point 15 s after it; `!`: a flight did not arrive within 0.5 m. *Wrongly nominal*: share
of that time with an error above 1 m and nominal health.

{table(found)}

**Decision.** The worst rows of station keeping (`python -m benchmarks.strangers hold`) and short flights are tests:
`tests/strangers`.
"""
