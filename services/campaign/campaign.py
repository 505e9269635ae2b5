"""A campaign from its file to its results: in a folder that it goes on with where it was interrupted.

DIR/
    campaign.toml      the file, resolved, and what made it; another campaign or version is refused in its folder
    base/              the scenario with all its files, before any field is varied
    parts/             rows as they came
    results.parquet    all rows, and timing.parquet what was measured (table.py)
    report.html        tables and pictures, where plotly is installed
"""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import msgspec
import tomli_w

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from services.campaign import engine as engines
from services.campaign.design import Point, points, value_at
from services.campaign.file import Campaign, Range
from services.campaign.keys import Value
from services.campaign.table import Parts
from services.campaign.trial import Base, Row, Trial, run_all, situation, version_of
from services.run.made_by import made_by
from services.run.situation import resolve

FILE, BASE = "campaign.toml", "base"


class Plan(msgspec.Struct, frozen=True):
    """What is to be done, checked."""

    campaign: Campaign
    base: Base
    points: list[Point]
    made_by: dict[str, str]

    @property
    def version(self) -> str:
        """What every worker must be."""
        return version_of(self.made_by)

    @property
    def runs(self) -> int:
        """In all."""
        return len(self.points) * self.campaign.seeds.count

    def trials(self) -> Iterator[Trial]:
        """Seed by seed within each point."""
        seeds = self.campaign.seeds
        for number, point in enumerate(self.points):
            settings, factors = self.settings(point), self.factors(point)
            for k in range(seeds.count):
                yield Trial(number * seeds.count + k, number, seeds.first + k, settings, factors, point)

    def settings(self, point: Point) -> dict[str, Value]:
        """The fields that this point gives a value."""
        own = {key: value for key, value in point.items() if key not in self.campaign.scale}
        return {**self.campaign.settings, **own}

    def factors(self, point: Point) -> dict[str, float]:
        """By what it multiplies fields."""
        made: dict[str, float] = {}
        for name, powers in self.campaign.scale.items():
            for key, power in powers.items() if name in point else ():
                made[key] = made.get(key, 1.0) * float(point[name]) ** power
        return made


def plan(campaign: Campaign, source: str) -> Plan:
    """Resolve the base, lay the points, and try each value of each field once. Raises ``ConfigError``."""
    made = Plan(campaign, tuple(sorted(resolve(campaign.scenario).files.items())), points(campaign), made_by())
    _try(made, {}, "[set]", source)
    for table, keys in (("vary", campaign.vary), ("cross", campaign.cross)):
        for key, over in keys.items():
            for value in (value_at(key, over, 0.0), value_at(key, over, 1.0)) if isinstance(over, Range) else over:
                _try(made, {key: value}, f"[{table}] {key}", source)
    return made


def _try(made: Plan, point: Point, field: str, source: str) -> None:
    try:
        situation(made.base, made.settings(point), made.factors(point), made.campaign.seeds.first)
    except ConfigError as error:
        raise ConfigError(source, field, str(error)) from None


@contextmanager
def opened(folder: Path, made: Plan) -> Iterator[Parts]:
    """The campaign's folder, a new one or its own, for as long as nobody else has it. Raises ``ConfigError``."""
    where = {"value": str(folder)}
    text = described(made)
    file = folder / FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not file.exists():
            if any(folder.iterdir()):
                raise ConfigError("option --out", "", "a folder that holds something else: name another", **where)
            for name, content in made.base:
                path = folder / BASE / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(content, encoding="utf-8")
            file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(
            "option --out", "", f"a folder that can be written is needed ({error.strerror})", **where
        ) from None
    if difference := _difference(file.read_text(encoding="utf-8"), text):
        problem = f"holds another campaign, or one of another version: {difference}; name another folder"
        raise ConfigError("option --out", "", problem, **where)
    with file.open("rb") as held:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError("option --out", "", "another process is at this campaign", **where) from None
        yield Parts(folder / "parts", made.campaign)


def described(made: Plan) -> str:
    """campaign.toml: the file's own tables, and ``made_by``."""
    table = msgspec.to_builtins(made.campaign)
    return tomli_w.dumps({**table, "made_by": made.made_by})


def run(
    made: Plan,
    parts: Parts,
    engine: engines.Engine,
    *,
    hear: Callable[[Sequence[Row]], None],
    stop: Callable[[], bool],
) -> None:
    """Do what is missing. ``hear`` is told the rows as they come."""
    there = parts.done()
    missing = [trial for trial in made.trials() if trial.place not in there]
    work = _Work(made.base, made.version)
    for rows in engines.done(engine, work, engines.batches(missing, engine.workers), made.version, stop=stop):
        parts.write(rows)
        hear(rows)


class _Work:
    """To be pickled: ``run_all`` with what all tasks have in common."""

    def __init__(self, base: Base, version: str) -> None:
        self._base, self._version = base, version

    def __call__(self, trials: tuple[Trial, ...]) -> list[Row]:
        return run_all(self._base, self._version, trials)


def reopened(folder: Path) -> Campaign:
    """The campaign of a folder. Raises ``ConfigError``."""
    table = config.read_toml(folder / FILE, what="campaign")
    table.pop("made_by", None)
    return config.parse(table, Campaign, source=f"campaign {folder / FILE}")


def _difference(there: str, here: str) -> str:
    """The first line in which two texts differ; empty where there is none."""
    for old, new in zip(there.splitlines(), here.splitlines(), strict=False):
        if old != new:
            return f"{old.strip()} there, {new.strip()} here"
    return "" if len(there) == len(here) else "more lines in one of both"
