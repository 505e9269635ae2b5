"""Campaign of many runs, from its file to its results, in a folder from which an interrupted campaign continues.

DIR/
    results.jsonl      the rows as they came; another campaign or version is refused in its folder
    campaign.toml      the file, resolved, and what made it
    base/              the scenario with all its files, before any field is varied
    results.parquet    all rows, and timing.parquet what was measured (table.py)
    report.html        tables and pictures, where plotly is installed
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property, partial
from pathlib import Path

import msgspec
import tomli_w

from ltv_mpc.errors import ConfigError
from services.run.folder import write_files
from services.run.provenance import provenance_table
from services.run.run_config import SCENARIO, resolve, scenario_text
from services.tools.batch import results_store
from services.tools.batch.executor import MAX_LOSSES, run_each
from services.tools.batch.results_store import ResultsStore
from services.tools.campaign import trial
from services.tools.campaign.file import Campaign, Point, Range, points, value_at
from services.tools.campaign.trial import Base, Row, Trial, row_of, run_config, version_of

FILE, BASE = "campaign.toml", "base"


class PreparedCampaign(msgspec.Struct, frozen=True, dict=True):
    """Checked campaign: design, base settings, and version."""

    campaign: Campaign
    base: Base
    made_by: dict[str, str]

    @cached_property
    def points(self) -> list[Point]:
        """Return the points of the design."""
        return points(self.campaign)

    @property
    def version(self) -> str:
        """Return the version that every worker must have."""
        return version_of(self.made_by)

    @property
    def runs(self) -> int:
        """Return the number of runs in all."""
        return len(self.points) * self.campaign.seeds.count

    def trials(self) -> Iterator[Trial]:
        """Generate the trials, seed by seed within each point."""
        first, count = self.campaign.seeds.first, self.campaign.seeds.count
        return (Trial(number, first + k, point) for number, point in enumerate(self.points) for k in range(count))


def plan(campaign: Campaign, source: str) -> PreparedCampaign:
    """Resolve the base, lay the points, and try each value of each field once. Raises ``ConfigError``."""
    base = resolve(campaign.scenario)
    # A point may change the vehicle, so the base leaves open what follows from the vehicle.
    files = {**base.files, SCENARIO: scenario_text(base.scenario, base.name)}
    made = PreparedCampaign(campaign, tuple(sorted(files.items())), provenance_table())
    _try(made, {}, "[set]", source)
    for table, keys in (("vary", campaign.vary), ("cross", campaign.cross)):
        for key, over in keys.items():
            for value in (value_at(key, over, 0.0), value_at(key, over, 1.0)) if isinstance(over, Range) else over:
                _try(made, {key: value}, f"[{table}] {key}", source)
    return made


def _try(made: PreparedCampaign, point: Point, field: str, source: str) -> None:
    try:
        run_config(made.base, made.campaign, Trial(0, made.campaign.seeds.first, point))
    except ConfigError as error:
        raise ConfigError(source, field, str(error)) from None


@contextmanager
def open_campaign(folder: Path, made: PreparedCampaign, *, force: bool = False) -> Iterator[ResultsStore]:
    """Open the campaign's folder, new or existing, for this process alone. Raises ``ConfigError``."""
    with results_store.open_store(folder, msgspec.to_builtins(made), force=force) as store:
        write_files(folder / BASE, dict(made.base))
        described = {**msgspec.to_builtins(made.campaign), "made_by": made.made_by}
        (folder / FILE).write_text(tomli_w.dumps(described), encoding="utf-8")
        yield store


def run(
    made: PreparedCampaign, store: ResultsStore, *, workers: int | None, cluster: str | None, stop: Callable[[], bool]
) -> Iterator[Row]:
    """Make the missing runs; yield each row as it ends and is stored."""
    missing = [one for one in made.trials() if one.key not in store.keys]

    def lost(one: Trial) -> Row:
        return row_of(one, made.version, f"its process was lost {MAX_LOSSES} times")

    work = partial(trial.run, made.base, made.campaign, made.version)
    for place, row in run_each(work, missing, workers=workers, cluster=cluster, stop=stop, lost=lost):
        store.append(missing[place].key, row)
        yield row


def reopen_campaign(folder: Path) -> tuple[PreparedCampaign, Iterator[Row]]:
    """Read the campaign of a folder, finished or not, and its rows. Raises ``ConfigError``."""
    settings, results = results_store.read(folder / results_store.NAME)
    try:
        return msgspec.convert(settings, PreparedCampaign), (row for _, row in results)
    except msgspec.ValidationError as error:
        raise ConfigError(f"results {folder}", "", f"is not a campaign: {error}") from None
