"""Make the paper's figures and tables: docs/figures/, the tables of docs/paper.md, and the README's picture.

    python -m benchmarks.paper [--seeds N] [--measured DIR] ...

All runs are made again in lock step with fixed seeds; only times are measured on this machine.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import typer

from benchmarks import page_tables
from benchmarks.paper import claims, descents, readme, sheets, tables, timing, water
from benchmarks.paper.renderer import Run
from benchmarks.paper.settings import README, RECORDED
from ltv_mpc.errors import ConfigError
from services.reporting.terminal import progress_bar
from services.run import folder
from services.tools.profile import machine_description

TABLES = ("claims", "descents", "timing")
FIGURES = "figures.json"


class Options(NamedTuple):
    """Options of the command."""

    out: Path = Path("docs/figures")  # PNG and figures.json
    runs: Path = Path("runs/figures")  # recordings and SVG
    page: Path = Path("docs/paper.md")
    readme: Path = Path("docs/descent.png")
    measured: Path = Path("../shared/data")
    seeds: int = 10
    cycles: int = 600  # timed at each horizon
    duration_s: float = 200.0
    workers: int | None = None


def main(arguments: Sequence[str] | None = None) -> int:
    """Make figures and tables. Return exit code 2 if an option or a file is wrong, before any run."""
    try:
        options = parsed(arguments)
        page = checked(options)
        made = make(options)
        options.page.write_text(page_tables.replace_tables(page, made.tables), encoding="utf-8")
    except ConfigError as error:
        typer.echo(str(error), err=True)
        return 2
    typer.echo(str(options.out))
    return 0


def parsed(arguments: Sequence[str] | None) -> Options:
    """Parse the command line."""
    default = Options()
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.paper",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    for name, words in (
        ("out", "folder of the PNG files and of figures.json"),
        ("runs", "folder of the recordings and SVG files"),
        ("page", "page whose tables are renewed"),
        ("readme", "file of the README's picture"),
        ("measured", "folder of measured currents; without it Fig 3 shows synthetic currents alone"),
    ):
        parser.add_argument(f"--{name}", type=Path, metavar="PATH", help=f"{words}; default {getattr(default, name)}")
    for name, words in (
        ("seeds", "number of seeds that are averaged"),
        ("cycles", "number of cycles timed at each horizon"),
        ("workers", "number of processes; default one for each core"),
    ):
        parser.add_argument(f"--{name}", type=int, metavar="N", help=words)
    parser.add_argument(
        "--duration-s", type=float, metavar="T", help=f"duration of a descent; default {default.duration_s:g}"
    )
    given = {name: value for name, value in vars(parser.parse_args(arguments)).items() if value is not None}
    return default._replace(**given)


def checked(options: Options) -> str:
    """Check all options and files, and return the page's text. Raises ``ConfigError``."""
    for name, least, most in (("seeds", 1, 10_000), ("cycles", 10, 100_000), ("workers", 1, 1000)):
        value = getattr(options, name)
        if value is not None and not least <= value <= most:
            raise ConfigError(f"option --{name}", "", f"must be {least} to {most}", value=value)
    try:
        page = options.page.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError("option --page", "", f"cannot be read: {error}", value=str(options.page)) from None
    for name in TABLES:
        page_tables.table_text(page, name)
    for variant in (*RECORDED, *README):
        descents.RecordedDescent(variant, options.runs, options.duration_s).run_config()
    for path in (options.out, options.runs, options.readme.parent):
        folder.open_folder(path, force=True)
    return page


def make(options: Options) -> tables.Figures:
    """Make runs, figures and figures.json. Raises ``ConfigError``."""
    profiles, missing = water.measured(options.measured)
    for path in missing:
        typer.echo(f"Fig 3 is drawn without {path}: no such file", err=True)
    with _steps("descents", len((*RECORDED, *README)) + claims.count(options.seeds)) as step:
        recorded = descents.recorded(options.runs, options.duration_s, workers=options.workers, progress=step)
        claimed = claims.over_seeds(options.seeds, options.duration_s, workers=options.workers, progress=step)
    with _steps("cycles, timed", 2 * options.cycles) as step:
        timed = timing.timed(options.cycles, progress=step)
    synthetic = [water.synthetic(seed) for seed in range(water.SEEDS)]
    runs: dict[str, list[Run]] = {key: [run] for key, (run, _) in recorded.items()} | {
        sheets.SYNTHETIC: [water.profile_run(one) for one in synthetic[: water.SHOWN_SEEDS]],
        sheets.MEASURED: [water.profile_run(one) for one in profiles],
        sheets.STRUCTURE: [water.structure_run(synthetic, profiles)],
        sheets.TIMING: [timing.run(timed)],
    }
    draw(options, runs, [one.name for one in profiles])
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


def draw(options: Options, runs: Mapping[str, Sequence[Run]], measured: Sequence[str]) -> None:
    """Draw every figure as PNG and SVG, and the README's picture."""
    for sheet in sheets.sheets(measured):
        sheets.write(sheet, runs, [options.out / f"{sheet.name}.png", options.runs / f"{sheet.name}.svg"])
    readme.write([run for variant in README for run in runs[variant.key]], options.readme)


@contextmanager
def _steps(what: str, total: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar on stderr and yield the function that advances it."""
    done = 0
    with progress_bar(f"{total} {what}") as told:

        def step() -> None:
            nonlocal done
            done += 1
            told(done / total)

        yield step


if __name__ == "__main__":
    sys.exit(main())
