"""Robustness table as text, page and JSON."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np

from benchmarks.robustness.cases import CASES
from benchmarks.robustness.flights import Row
from benchmarks.robustness.laws import DEFAULT, LAWS, RIVALS
from benchmarks.strangers.flight import SHIPPED
from benchmarks.strangers.tasks import Figures
from services.run.provenance import provenance_table

VEHICLES = ("ellipsoid", "light_boat", *SHIPPED)
PAGE = Path("docs/notes/robustness-table.md")
Found = dict[Row, dict[str, Figures]]
ROUNDING_M = 0.0005
"""Difference of means that a table with three decimals does not show."""


def lead_m(of: dict[str, Figures]) -> float:
    """Return by how much the default's mean is above that of the better rival; negative: below."""
    return of[DEFAULT].mean_m - min(of[law].mean_m for law in RIVALS if law in of)


def _is_behind(of: dict[str, Figures]) -> bool:
    return lead_m(of) > ROUNDING_M


def table(found: Found) -> str:
    """Return the rows, those first in which the controller is most behind the better rival."""
    laws = [law for law in LAWS if law in next(iter(found.values()))]
    lines = ["| | vehicle | task | case | " + " | ".join(laws) + " |", "|---" * (4 + len(laws)) + "|"]
    for row in sorted(found, key=lambda row: -lead_m(found[row])):
        cells = " | ".join(_cell(found[row][law]) for law in laws)
        mark = "worse" if _is_behind(found[row]) else ""
        lines.append(f"| {mark} | {row.vehicle} | {row.task} | {row.case} | {cells} |")
    return "\n".join(lines)


def cases_table(found: Found) -> str:
    """Return by case the median of the mean errors over vehicles and tasks, and the rows with a better rival."""
    laws = list(next(iter(found.values())))
    lines = ["| case | " + " | ".join(laws) + " | rival better |", "|---" * (2 + len(laws)) + "|"]
    for case in dict.fromkeys(row.case for row in found):
        of = [found[row] for row in found if row.case == case]
        medians = " | ".join(f"{np.median([x[law].mean_m for x in of]):.3f}" for law in laws)
        lines.append(f"| {case} | {medians} | {sum(map(_is_behind, of))}/{len(of)} |")
    return "\n".join(lines)


def _cell(figures: Figures) -> str:
    return f"{figures.mean_m:.3f} / {figures.max_m:.2f}" + ("" if np.isfinite(figures.arrival_s) else "!")


def summary(found: Found) -> str:
    """Return the number of rows in which the default is behind, and the median of the means by law."""
    behind = sum(map(_is_behind, found.values()))
    laws = list(next(iter(found.values())))
    medians = ", ".join(f"{law} {np.median([of[law].mean_m for of in found.values()]):.3f}" for law in laws)
    late = ", ".join(f"{law} {sum(not np.isfinite(of[law].arrival_s) for of in found.values())}" for law in laws)
    return (
        f"The default's mean is above that of the better rival in {behind} of {len(found)} rows. Median of the mean "
        f"errors (m): {medians}. Rows that did not arrive: {late}."
    )


def _cases_flown(found: Found) -> str:
    """Return the number of cases, which vehicles flew fewer of them, and which none."""
    of = {vehicle: len({row.case for row in found if row.vehicle == vehicle}) for vehicle, _, _ in found}
    most = max(of.values())
    fewer = [f"`{vehicle}` {count}" for vehicle, count in of.items() if count < most]
    missing = [f"`{vehicle}`" for vehicle in VEHICLES if vehicle not in of]
    return (
        f"{most} of {len(CASES)} cases"
        + (f", of {', '.join(fewer)}" if fewer else "")
        + (f". Not flown: {', '.join(missing)}" if missing else "")
    )


def text(found: Found, starts: int) -> str:
    """Return the page."""
    vehicles = ", ".join(f"`{name}`" for name in dict.fromkeys(row.vehicle for row in found))
    return f"""# Robustness table

**Question.** How well does the controller keep station and path when vehicle, thrusters, navigation and sea are not
those of the vehicle file, beside a tuned PID and LQR?

**Method.** `python -m benchmarks.robustness --write`: the loop and the hulls of the [strangers](strangers.md), a point
5 m away and a square of 20 m, in a current of a fifth of the top speed that no estimate contains. `drag=0.5`: the
true vehicle has half of the file's drag (`benchmarks/robustness/cases.py`). PID and LQR are tuned once a vehicle, on
the right file; LQR alone is given the current. Starts a row: {starts}. Flown: {vehicles}; {_cases_flown(found)}.

**Date.** {datetime.datetime.now(tz=datetime.UTC):%Y-%m}. **Version.** {provenance_table()["commit"][:8]}.

**Result.** {summary(found)}

Median over vehicles and tasks of the mean distance (m): from the point 15 s after the arrival, or from the path from
15 s until the arrival. The command prints all rows.

{cases_table(found)}

**Decision.** A few rows are tests with limits from these figures: `tests/benchmarks/test_robustness.py`.
"""
