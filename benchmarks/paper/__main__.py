"""Make the paper's figures and tables: docs/figures/, the tables of docs/paper.md, and the README's picture.

    python -m benchmarks.paper [--seeds N] [--measured DIR] ...

All runs are made again in lock step with fixed seeds; only times are measured on this machine.
"""

from __future__ import annotations

import argparse
import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks import page_tables
from benchmarks.paper import claims, descents, readme, sheets, tables, timing, water
from benchmarks.paper.renderer import Run
from benchmarks.paper.settings import README, RECORDED
from services.tools.profile import machine_description

TABLES = ("claims", "descents", "timing")
FIGURES = "figures.json"


def main() -> None:
    """Make figures and tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default, words in (
        ("--out", "docs/figures", "folder of the PNG files and of figures.json"),
        ("--runs", "runs/figures", "folder of the recordings and SVG files"),
        ("--page", "docs/paper.md", "page whose tables are renewed"),
        ("--readme", "docs/descent.png", "file of the README's picture"),
        (
            "--measured",
            "../shared/data",
            "folder of measured currents; without it Fig 3 shows synthetic currents alone",
        ),
    ):
        parser.add_argument(name, type=Path, default=default, metavar="PATH", help=f"{words}; default %(default)s")
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds that are averaged")
    parser.add_argument("--cycles", type=int, default=600, help="number of cycles timed at each horizon")
    parser.add_argument("--workers", type=int, help="number of processes; default one for each core")
    parser.add_argument("--duration-s", type=float, default=200.0, help="duration of a descent")
    options = parser.parse_args()
    page = options.page.read_text(encoding="utf-8")
    for name in TABLES:
        page_tables.table_text(page, name)  # before any run
    made = make(options)
    options.page.write_text(page_tables.replace_tables(page, made.tables), encoding="utf-8")
    print(options.out)


def make(options: Namespace) -> tables.Figures:
    """Make runs, figures and figures.json. Raises ``ConfigError``."""
    profiles, missing = water.measured(options.measured)
    for path in missing:
        print(f"Fig 3 is drawn without {path}: no such file", file=sys.stderr)
    recorded = descents.recorded(options.runs, options.duration_s, workers=options.workers)
    claimed = claims.over_seeds(options.seeds, options.duration_s, workers=options.workers)
    timed = timing.timed(options.cycles)
    runs: dict[str, list[Run]] = {key: [run] for key, (run, _) in recorded.items()} | {
        sheets.SYNTHETIC: [water.profile_run(water.synthetic(seed)) for seed in range(water.SHOWN_SEEDS)],
        sheets.MEASURED: [water.profile_run(one) for one in profiles],
        sheets.TIMING: [timing.run(timed)],
    }
    draw(options, runs)
    figures = tables.Figures(
        made_with=f"seed {descents.SEED} recorded, seeds 0 to {options.seeds - 1} averaged, {options.duration_s:g} s",
        machine=machine_description.line(timed.machine),
        tables=(
            claims.table(claimed),
            tables.descents({variant.key: recorded[variant.key][1] for variant in RECORDED}),
            tables.timing(timed),
        ),
    )
    figures.write(options.out / FIGURES)
    return figures


def draw(options: Namespace, runs: Mapping[str, Sequence[Run]]) -> None:
    """Draw every figure as PNG and SVG, and the README's picture."""
    for sheet in sheets.SHEETS:
        sheets.write(sheet, runs, [options.out / f"{sheet.name}.png", options.runs / f"{sheet.name}.svg"])
    readme.write([run for variant in README for run in runs[variant.key]], options.readme)


if __name__ == "__main__":
    main()
