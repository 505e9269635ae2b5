"""A campaign's file: which scenario, which fields vary over what, and over which seeds.

    title = "which horizon in which current"
    scenario = "descent"                                  # NAME or FILE, as for `ltv-mpc sim`
    minimise = "true_error_m.mean"                        # any figure of summary.json

    [seeds]
    count = 20                                            # the same for every point: differences are paired

    [design]
    kind = "grid"                                         # or "random", "sobol", with points = 64

    [set]
    run.perfect_state = true

    [vary]
    controller.horizon_s = [2.5, 5.0, 10.0]
    water.correlation_length_m = { low = 2.0, high = 30.0, scale = "log" }      # not in a grid
    vehicle.thruster.port.arm_m = [0.05, 0.2]             # a field of the vehicle's file

Keys are those of a run's scenario.toml, and ``vehicle.`` before those of its vehicle's file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import reduce
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
from msgspec import Meta

from ltv_mpc import config, fields
from ltv_mpc.errors import ConfigError
from ltv_mpc.vehicle.parameters import Vehicle
from sim.grading.summary import Summary
from sim.scenario import Scenario

Value: TypeAlias = bool | int | float | str
MOST_RUNS = 10_000_000
VEHICLE = "vehicle"


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class Range(_Table, frozen=True, kw_only=True):
    """Every number between two, both included."""

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"

    def at(self, share: float) -> float:
        """The number that ``share``, 0 .. 1, of the range lies below."""
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** share)
        return self.low + share * (self.high - self.low)


Choices: TypeAlias = tuple[Value, ...]


class Seeds(_Table, frozen=True, kw_only=True):
    """``first``, ``first`` + 1, and so on."""

    first: Annotated[int, Meta(ge=0, le=2**52)] = 0
    count: Annotated[int, Meta(ge=1, le=1_000_000)] = 10


class Design(_Table, frozen=True, kw_only=True):
    """How points are laid: every combination; drawn; or a scrambled Sobol sequence, which fills the space evenly."""

    kind: Literal["grid", "random", "sobol"] = "grid"
    points: Annotated[int, Meta(ge=1, le=1_000_000)] = 64  # of random and sobol; for sobol best a power of two
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 0


class Campaign(_Table, frozen=True, kw_only=True):
    """Everything that a campaign is made of. ``settings`` and ``vary`` by dotted key."""

    title: str
    scenario: str = "descent"
    minimise: str = "true_error_m.mean"
    seeds: Seeds = Seeds()
    design: Design = Design()
    settings: dict[str, Value] = msgspec.field(default_factory=dict, name="set")
    vary: dict[str, Choices | Range] = msgspec.field(default_factory=dict)


def load(path: Path) -> Campaign:
    """Read and check; a scenario's FILE is relative to the campaign's. Raises ``ConfigError``."""
    source = f"campaign {path}"
    table = config.read_toml(path, what="campaign")
    flat = dict(table)
    for name in ("set", "vary"):
        if isinstance(table.get(name), dict):
            flat[name] = dict(_flat(table[name], ""))
    campaign = config.parse(flat, Campaign, source=source)
    if config.is_path(campaign.scenario):
        campaign = msgspec.structs.replace(campaign, scenario=str(path.parent / campaign.scenario))
    _check(campaign, source)
    return campaign


def kind_of(key: str) -> fields.Type | None:
    """The type of a field that a campaign may set; None where there is no such field."""
    if key.startswith(f"{VEHICLE}."):
        return _VEHICLE.get(key.removeprefix(f"{VEHICLE}."))
    return _SCENARIO.get(key)


def figures() -> dict[str, fields.Type]:
    """The figures of summary.json that a run in lock step has, by dotted key: no measured time is among them."""
    return {key: kind for key, kind in fields.settings(Summary).items() if key.partition(".")[0] not in NO_FIGURES}


NO_FIGURES = frozenset(
    {
        "scenario", "mode", "seed", "speed", "compute_delay_wall_s", "end_to_end_delay_wall_s", "stages_us",
        "qp_status", "plan_origin",
    }
)  # fmt: skip
"""Of summary.json: what identifies a run, what is measured on the wall, and counts by name, which ``trial.py`` adds."""

_SCENARIO = {
    key: kind for key, kind in fields.settings(Scenario).items() if key not in ("made_by", "title", "run.seed")
}


def _optional_too(kind: Any, prefix: str) -> Iterator[tuple[str, fields.Type]]:
    """Scalar fields, those of tables that may be left out too."""
    for key, found in fields.settings(kind).items():
        inner = getattr(found, "types", ())
        tables = [x for x in inner if isinstance(x, msgspec.inspect.StructType)]
        if tables:
            yield from _optional_too(tables[0].cls, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", found


_VEHICLE = dict(_optional_too(Vehicle, ""))


def _flat(table: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Tables in tables as dotted keys; a table with ``low`` is a range."""
    for key, value in table.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, dict) and "low" not in value:
            yield from _flat(value, name)
        else:
            yield name, value


def _check(campaign: Campaign, source: str) -> None:
    """What no single field can tell."""
    known = [*_SCENARIO, *(f"{VEHICLE}.{key}" for key in _VEHICLE)]
    for table, keys in (("set", campaign.settings), ("vary", campaign.vary)):
        for key in keys:
            if kind_of(key) is None:
                raise ConfigError(source, f"[{table}] {key}", f"unknown key{fields.nearest(key, known)}")
    for key in campaign.vary.keys() & campaign.settings.keys():
        raise ConfigError(source, f"[vary] {key}", "stands in [set] too: leave one out")
    if not campaign.vary:
        raise ConfigError(source, "[vary]", "must name at least one key: nothing varies")
    for key, over in campaign.vary.items():
        _check_values(over, campaign.design.kind, f"[vary] {key}", source)
    if campaign.minimise not in figures():
        problem = f"must be a figure of summary.json{fields.nearest(campaign.minimise, figures())}"
        raise ConfigError(source, "minimise", problem, value=campaign.minimise)
    sizes = [len(over) for over in campaign.vary.values() if not isinstance(over, Range)]
    points = reduce(int.__mul__, sizes, 1) if campaign.design.kind == "grid" else campaign.design.points
    if points * campaign.seeds.count > MOST_RUNS:
        problem = f"{points} points times {campaign.seeds.count} seeds: at most {MOST_RUNS} runs"
        raise ConfigError(source, "", problem)


def _check_values(over: Choices | Range, design: str, field: str, source: str) -> None:
    if isinstance(over, Range):
        if design == "grid":
            raise ConfigError(source, field, 'must be a list of values where [design] kind = "grid"')
        if not over.low < over.high:
            raise ConfigError(source, f"{field}.high", f"must be > low = {over.low:g}", value=over.high)
        if over.scale == "log" and over.low <= 0:
            raise ConfigError(source, f"{field}.low", 'must be > 0 where scale = "log"', value=over.low)
    elif not over:
        raise ConfigError(source, field, "must have at least one value")
    elif len(set(over)) < len(over):
        raise ConfigError(source, field, "must not have a value twice")
