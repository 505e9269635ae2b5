"""Campaign file: the scenario, the fields that vary, their values, and the seeds.

    title = "which horizon in which current"
    scenario = "descent"                                  # NAME or FILE, as for `ltv-mpc sim`
    minimise = "true_error_m.mean"                        # any metric of summary.json

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
    size = { low = 0.5, high = 2.0, scale = "log" }       # a factor: [scale.size] says of what

    [cross]                                               # every point of the design with each of these
    controller.solver = ["osqp", "riccati"]

    [scale.size]                                          # base value times size to this power
    vehicle.dry_mass_kg = 3
    vehicle.thruster.port.arm_m = 1

Keys are those of a run's scenario.toml, and those of its vehicle's and reference's files (keys.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import reduce
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
from msgspec import Meta

from ltv_mpc import config, settings_schema
from ltv_mpc.errors import ConfigError
from services.tools.campaign.keys import Value, kind_of, known
from sim.evaluation.summary import Summary

MAX_RUNS = 10_000_000


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class Range(_Table, frozen=True, kw_only=True):
    """Range of numbers, both limits included."""

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"

    def interpolate(self, fraction: float) -> float:
        """Return the number at position ``fraction``, 0 .. 1, of the range."""
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** fraction)
        return self.low + fraction * (self.high - self.low)


Choices: TypeAlias = tuple[Value, ...]


class Seeds(_Table, frozen=True, kw_only=True):
    """Consecutive seeds: ``first``, ``first`` + 1, and so on."""

    first: Annotated[int, Meta(ge=0, le=2**52)] = 0
    count: Annotated[int, Meta(ge=1, le=1_000_000)] = 10


class Design(_Table, frozen=True, kw_only=True):
    """Type of design: every combination, random points, or a scrambled Sobol sequence, which fills the space evenly."""

    kind: Literal["grid", "random", "sobol"] = "grid"
    points: Annotated[int, Meta(ge=1, le=1_000_000)] = 64  # of random and sobol; for sobol best a power of two
    seed: Annotated[int, Meta(ge=0, le=2**32 - 1)] = 0


class Campaign(_Table, frozen=True, kw_only=True):
    """Settings of a campaign; tables by dotted key.

    A name with a ``[scale.NAME]`` table is a factor f. Each key k of that table is set to base[k] * f**power[k].
    """

    title: str
    scenario: str = "descent"
    minimise: str = "true_error_m.mean"
    seeds: Seeds = Seeds()
    design: Design = Design()
    settings: dict[str, Value] = msgspec.field(default_factory=dict, name="set")
    vary: dict[str, Choices | Range] = msgspec.field(default_factory=dict)
    cross: dict[str, Choices] = msgspec.field(default_factory=dict)
    scale: dict[str, dict[str, float]] = msgspec.field(default_factory=dict)

    @property
    def varied(self) -> dict[str, Choices | Range]:
        """Return all keys in which points differ, those of ``vary`` and those of ``cross``."""
        return {**self.vary, **self.cross}


def load(path: Path) -> Campaign:
    """Read and check a campaign file; a scenario's FILE is relative to it. Raises ``ConfigError``."""
    source = f"campaign {path}"
    table = config.read_toml(path, what="campaign")
    flat = dict(table)
    for name in ("set", "vary", "cross"):
        if isinstance(table.get(name), dict):
            flat[name] = dict(_flatten_keys(table[name], ""))
    if isinstance(table.get("scale"), dict):
        flat["scale"] = {
            name: dict(_flatten_keys(powers, "")) if isinstance(powers, dict) else powers
            for name, powers in table["scale"].items()
        }
    campaign = config.parse(flat, Campaign, source=source)
    if config.is_path(campaign.scenario):
        campaign = msgspec.structs.replace(campaign, scenario=str(path.parent / campaign.scenario))
    _check(campaign, source)
    return campaign


def metrics() -> dict[str, settings_schema.Type]:
    """Return the computed metrics of summary.json by dotted key; measured times are left out."""
    return {
        key: kind
        for key, kind in settings_schema.scalar_fields(Summary).items()
        if key.partition(".")[0] not in EXCLUDED_METRICS and not settings_schema.is_text(kind)
    }


EXCLUDED_METRICS = frozenset(
    {
        "seed", "speed", "speed_reached", "compute_delay_wall_s", "end_to_end_delay_wall_s", "stages_us", "qp_status",
        "plan_origin", "health", "fence",
    }
)  # fmt: skip
"""Keys of summary.json without a column, beside texts: seed, wall times, zones, and counts by name, which ``trial.py``
adds."""


def _flatten_keys(table: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Flatten nested tables to dotted keys; a table with ``low`` is a range."""
    for key, value in table.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, dict) and "low" not in value:
            yield from _flatten_keys(value, name)
        else:
            yield name, value


def _check(campaign: Campaign, source: str) -> None:
    """Check the rules that concern several fields. Raises ``ConfigError``."""
    for table, keys in (("set", campaign.settings), ("vary", campaign.vary), ("cross", campaign.cross)):
        factors = campaign.scale if table != "set" else {}
        for key in keys:
            if kind_of(key) is None and key not in factors:
                problem = f"unknown key{settings_schema.suggestion(key, [*known(), *factors])}"
                raise ConfigError(source, f"[{table}] {key}", problem)
    for table, keys, other in (
        ("vary", campaign.vary, campaign.settings),
        ("cross", campaign.cross, campaign.settings),
        ("cross", campaign.cross, campaign.vary),
    ):
        for key in keys.keys() & other.keys():
            where = "set" if other is campaign.settings else "vary"
            raise ConfigError(source, f"[{table}] {key}", f"is also in [{where}]: remove one of them")
    if not campaign.varied:
        raise ConfigError(source, "[vary]", "must name at least one key to vary")
    for key, values_or_range in campaign.vary.items():
        _check_values(values_or_range, campaign.design.kind, f"[vary] {key}", source)
    for key, values in campaign.cross.items():
        _check_values(values, "grid", f"[cross] {key}", source)
    for name, powers in campaign.scale.items():
        _check_factor(campaign, name, powers, source)
    if campaign.minimise not in metrics():
        problem = f"must be a metric of summary.json{settings_schema.suggestion(campaign.minimise, metrics())}"
        raise ConfigError(source, "minimise", problem, value=campaign.minimise)
    sizes = [len(values) for values in campaign.cross.values()]
    if campaign.design.kind == "grid":
        sizes += [len(values) for values in campaign.vary.values() if not isinstance(values, Range)]
    else:
        sizes.append(campaign.design.points)
    points = reduce(int.__mul__, sizes, 1)
    if points * campaign.seeds.count > MAX_RUNS:
        problem = f"{points} points times {campaign.seeds.count} seeds: at most {MAX_RUNS} runs"
        raise ConfigError(source, "", problem)


def _check_factor(campaign: Campaign, name: str, powers: Mapping[str, float], source: str) -> None:
    where = f"[scale.{name}]"
    if kind_of(name) is not None:
        raise ConfigError(source, where, f"{name} is a field name: rename the factor")
    values_or_range = campaign.varied.get(name)
    if values_or_range is None:
        raise ConfigError(source, where, f"scales {name}, which is neither in [vary] nor in [cross]")
    for value in (values_or_range.low, values_or_range.high) if isinstance(values_or_range, Range) else values_or_range:
        if isinstance(value, bool | str) or value <= 0:
            raise ConfigError(source, f"[vary] {name}", "a factor must be > 0", value=value)
    for key in powers:
        if not isinstance(kind_of(key), msgspec.inspect.FloatType):
            names = [one for one in known() if isinstance(kind_of(one), msgspec.inspect.FloatType)]
            raise ConfigError(
                source, f"{where} {key}", f"must be a field with a number{settings_schema.suggestion(key, names)}"
            )


def _check_values(values_or_range: Choices | Range, design: str, field: str, source: str) -> None:
    if isinstance(values_or_range, Range):
        if design == "grid":
            raise ConfigError(source, field, 'must be a list of values where [design] kind = "grid"')
        if not values_or_range.low < values_or_range.high:
            raise ConfigError(
                source, f"{field}.high", f"must be > low = {values_or_range.low:g}", value=values_or_range.high
            )
        if values_or_range.scale == "log" and values_or_range.low <= 0:
            raise ConfigError(source, f"{field}.low", 'must be > 0 where scale = "log"', value=values_or_range.low)
    elif not values_or_range:
        raise ConfigError(source, field, "must have at least one value")
    elif len(set(values_or_range)) < len(values_or_range):
        raise ConfigError(source, field, "must not have a value twice")
