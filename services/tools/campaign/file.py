"""Campaign file: the scenario, the fields that vary, their values, the seeds, and the points that they mean.

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

Keys are those of a run's scenario.toml, and those of its vehicle's and reference's files with their name before them,
``vehicle.surge.mass_kg``, ``reference.descent_rate_mps``.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta, inspect
from scipy.stats import qmc

from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.references import Reference
from ltv_mpc.settings_schema import Type, flat, is_text, scalar_fields, suggestion
from ltv_mpc.vehicle.parameters import Vehicle
from sim.evaluation.summary import Summary
from sim.scenario import Scenario

Value: TypeAlias = bool | int | float | str

VEHICLE, REFERENCE = "vehicle", "reference"
MAX_RUNS = 10_000_000


def _with_optional(kind: Any, prefix: str) -> Iterator[tuple[str, Type]]:
    """Generate the scalar fields, also those of tables that may be left out."""
    for key, found in scalar_fields(kind).items():
        inner = getattr(found, "types", ())
        tables = [x for x in inner if isinstance(x, inspect.StructType)]
        if tables:
            yield from _with_optional(tables[0].cls, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", found


KINDS: dict[str, Type] = {
    **{key: kind for key, kind in scalar_fields(Scenario).items() if key not in ("made_by", "title", "run.seed")},
    **dict(_with_optional(Vehicle, f"{VEHICLE}.")),
    **{key: kind for one in Reference.__args__ for key, kind in _with_optional(one, f"{REFERENCE}.")},
}
"""Types of the fields that a campaign may set, by key."""


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
Point: TypeAlias = dict[str, Value]


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

    def point_settings(self, point: Point) -> dict[str, Value]:
        """Return the fields that this point sets."""
        own = {key: value for key, value in point.items() if key not in self.scale}
        return {**self.settings, **own}

    def factors(self, point: Point) -> dict[str, float]:
        """Return the factors by which this point multiplies fields."""
        made: dict[str, float] = {}
        for name, powers in self.scale.items():
            for key, power in powers.items() if name in point else ():
                made[key] = made.get(key, 1.0) * float(point[name]) ** power
        return made


def load(path: Path) -> Campaign:
    """Read and check a campaign file; a scenario's FILE is relative to it. Raises ``ConfigError``."""
    source = f"campaign {path}"
    table = config.read_toml(path, what="campaign")
    for name in ("set", "vary", "cross"):
        if isinstance(table.get(name), dict):
            table[name] = flat(table[name], whole="low")
    if isinstance(table.get("scale"), dict):
        table["scale"] = {
            name: flat(powers) if isinstance(powers, dict) else powers for name, powers in table["scale"].items()
        }
    campaign = config.parse(table, Campaign, source=source)
    if config.is_path(campaign.scenario):
        campaign = msgspec.structs.replace(campaign, scenario=str(path.parent / campaign.scenario))
    for field, problem, value in _problems(campaign):
        raise ConfigError(source, field, problem, value=value)
    return campaign


def points(campaign: Campaign) -> list[Point]:
    """List the points of ``vary``, each combined with all of ``cross``, the last key fastest; the order is
    reproducible.
    """
    crossed = _combinations(campaign.cross)
    return [{**laid, **more} for laid in _laid(campaign) for more in crossed]


def _laid(campaign: Campaign) -> list[Point]:
    """Return the points of ``vary``: all combinations, or drawn positions in the ranges, each in 0 .. 1."""
    design, vary = campaign.design, campaign.vary
    if design.kind == "grid":
        return _combinations({key: over for key, over in vary.items() if not isinstance(over, Range)})
    rng = np.random.default_rng(design.seed)
    if design.kind == "random":
        drawn = rng.random((design.points, len(vary)))
    else:
        with warnings.catch_warnings():  # another number than a power of two fills less evenly: the file's choice
            warnings.simplefilter("ignore", UserWarning)
            drawn = qmc.Sobol(len(vary), scramble=True, rng=rng).random(design.points)
    return [
        {key: value_at(key, over, share) for (key, over), share in zip(vary.items(), shares, strict=True)}
        for shares in drawn.tolist()
    ]


def _combinations(lists: Mapping[str, Choices]) -> list[Point]:
    return [dict(zip(lists, values, strict=True)) for values in itertools.product(*lists.values())]


def value_at(key: str, over: Choices | Range, share: float) -> Value:
    """Return the value at position ``share``, 0 .. 1, of a range or list."""
    if isinstance(over, Range):
        number = over.interpolate(share)
        return round(number) if isinstance(KINDS.get(key), inspect.IntType) else number
    return over[min(int(share * len(over)), len(over) - 1)]


def metrics() -> dict[str, Type]:
    """Return the computed metrics of summary.json by dotted key; measured times are left out."""
    return {
        key: kind
        for key, kind in scalar_fields(Summary).items()
        if key.partition(".")[0] not in EXCLUDED_METRICS and not is_text(kind)
    }


EXCLUDED_METRICS = frozenset(
    {
        "seed", "speed", "speed_reached", "compute_delay_wall_s", "end_to_end_delay_wall_s", "qp_status",
        "plan_origin", "health", "fence",
    }
)  # fmt: skip
"""Keys of summary.json without a column, beside texts: seed, wall times, zones, and counts by name, which ``trial.py``
adds."""


Problem: TypeAlias = tuple[str, str, object]
"""Field, what is wrong with it, and its value if there is one to show."""


def _problems(campaign: Campaign) -> Iterator[Problem]:
    """Yield what is wrong by the rules that concern several fields; the first one is the error."""
    grid, table_of = campaign.design.kind == "grid", dict[str, str]()
    for table, keys in (("set", campaign.settings), ("vary", campaign.vary), ("cross", campaign.cross)):
        names = {*KINDS, *(campaign.scale if table != "set" else ())}
        for key in keys:
            if key not in names:
                yield f"[{table}] {key}", f"unknown key{suggestion(key, names)}", None
            if key in table_of:
                yield f"[{table}] {key}", f"is also in [{table_of[key]}]: remove one of them", None
            table_of[key] = table
    if not campaign.varied:
        yield "[vary]", "must name at least one key to vary", None
    for key, over in campaign.varied.items():
        if isinstance(over, Range):
            yield from _of_range(f"[vary] {key}", over, grid=grid)
        elif not over or len(set(over)) < len(over):
            yield f"[{table_of[key]}] {key}", "must have at least one value, and none twice", None
    for name, powers in campaign.scale.items():
        yield from _of_factor(name, powers, campaign.varied.get(name))
    if campaign.minimise not in metrics():
        problem = f"must be a metric of summary.json{suggestion(campaign.minimise, metrics())}"
        yield "minimise", problem, campaign.minimise
    lists = [over for over in (campaign.varied if grid else campaign.cross).values() if not isinstance(over, Range)]
    count = math.prod(map(len, lists)) * (1 if grid else campaign.design.points)
    if count * campaign.seeds.count > MAX_RUNS:
        yield "", f"{count} points times {campaign.seeds.count} seeds: at most {MAX_RUNS} runs", None


def _of_range(field: str, over: Range, *, grid: bool) -> Iterator[Problem]:
    if grid:
        yield field, 'must be a list of values where [design] kind = "grid"', None
    if not over.low < over.high:
        yield f"{field}.high", f"must be > low = {over.low:g}", over.high
    if over.scale == "log" and over.low <= 0:
        yield f"{field}.low", 'must be > 0 where scale = "log"', over.low


def _of_factor(name: str, powers: Iterable[str], over: Choices | Range | None) -> Iterator[Problem]:
    if name in KINDS:
        yield f"[scale.{name}]", f"{name} is a field name: rename the factor", None
    if over is None:
        yield f"[scale.{name}]", f"scales {name}, which is neither in [vary] nor in [cross]", None
        return
    for value in (over.low,) if isinstance(over, Range) else over:
        if isinstance(value, bool | str) or value <= 0:
            yield f"[vary] {name}", "a factor must be > 0", value
    numbers = [key for key, kind in KINDS.items() if isinstance(kind, inspect.FloatType)]
    for key in powers:
        if key not in numbers:
            yield f"[scale.{name}] {key}", f"must be a field with a number{suggestion(key, numbers)}", None
