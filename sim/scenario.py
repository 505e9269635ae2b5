"""Scenario of a simulated run: water, plant, duration, and the settings of controller and estimator."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Sequence
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
from msgspec import Meta

from ltv_mpc import config, settings_schema
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.currents import check_cells
from ltv_mpc.errors import ConfigError, format_value
from ltv_mpc.localisation.config import MAX_CELLS, EstimatorConfig

MAX_WATER_CELLS = 20_000

GRAVITY_MPS2 = 9.81
STEEPEST = 1.0 / 7.0
"""Height over length of a wave beyond which it breaks."""
SURFACED_M = 0.5
"""Depth below which no wind acts."""

Factor: TypeAlias = Annotated[float, Meta(gt=0, le=10)]
Angle: TypeAlias = Annotated[float, Meta(ge=-6.2832, le=6.2832)]
Force: TypeAlias = Annotated[float, Meta(ge=0, le=1e5)]


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class Feature(_Table, frozen=True, kw_only=True):
    """Feature added to the current, unknown to the filter; ``kind`` decides which of the keys are read."""

    kind: Literal["none", "front", "step", "waves", "tide"] = "none"
    step_mps: Annotated[float, Meta(ge=-2, le=2)] = 0.1  # front, step: by how much the water's velocity changes
    direction_rad: Angle = 0.0  # towards which, from north
    at_s: Annotated[float, Meta(ge=-1e5, le=1e6)] = 100.0  # front: vehicle time of the middle of its passage
    width_s: Annotated[float, Meta(ge=1, le=1e5)] = 10.0  # front: how long it takes to pass
    at_m: Annotated[float, Meta(ge=0.5, le=2000)] = 20.0  # step: depth of its middle
    amplitude_mps: Annotated[float, Meta(ge=0, le=2)] = (
        0.05  # waves: at the surface and at water.deepest_m; tide: all depths
    )
    period_s: Annotated[float, Meta(ge=20, le=1e5)] = 600.0  # waves: some minutes at least, the buoyancy period; tide


class SurfaceWaves(_Table, frozen=True, kw_only=True):
    """Regular wave whose orbital velocity is added to the current; the filter does not know it."""

    height_m: Annotated[float, Meta(ge=0, le=30)] = 0.0  # between crest and lowest point; 0: none
    period_s: Annotated[float, Meta(ge=1, le=30)] = 5.0
    direction_rad: Angle = 0.0  # towards which, from north


class Water(_Table, frozen=True, kw_only=True):
    """Current over depth: a Gauss-Markov profile from the seed, or a measured profile."""

    kind: Literal["markov", "measured"] = "markov"
    sd_mps: Annotated[float, Meta(ge=0, le=5)] = 0.04  # paper: about 4 cm/s
    correlation_length_m: Annotated[float, Meta(gt=0, le=1000)] = 8.0  # from measured profiles
    bound_sd: Annotated[float, Meta(gt=0, le=10)] = 3.0  # paper: bounded; 2 would shrink the sd to 0.86 to 0.92 of it
    deepest_m: Annotated[float, Meta(gt=0, le=2000)] = 70.0  # 40 m of descent and 30 m of ADCP range
    cell_m: Annotated[float, Meta(gt=0, le=100)] = 1.0
    file: str = ""  # a currents CSV, where kind is "measured"
    change_mps_per_rts: Annotated[float, Meta(ge=0, le=1)] = 0.0  # each cell's random walk in time
    bottom_m: Annotated[float, Meta(gt=0, le=12_000)] | None = None  # flat sea bed, for sound only; None: out of reach
    feature: Feature = Feature()
    surface_waves: SurfaceWaves = SurfaceWaves()


class Mismatch(_Table, frozen=True, kw_only=True):
    """Mismatch between plant and controller's model: factors on the values of the vehicle file."""

    mass: Factor = 1.0
    drag: Factor = 1.0
    thrust: Factor = 1.0  # of all thrusters; the next two apply besides
    port_thrust: Factor = 1.0
    starboard_thrust: Factor = 1.0
    port_arm: Factor = 1.0
    starboard_arm: Factor = 1.0
    lag: Factor = 1.0
    extra_lag_s: Annotated[float, Meta(ge=0, le=60)] = 0.0  # added to the lag after the factor

    @property
    def thrusts(self) -> tuple[float, float, float]:
        """Factors on the thrust of port, starboard and vertical."""
        return self.thrust * self.port_thrust, self.thrust * self.starboard_thrust, self.thrust


class Actuators(_Table, frozen=True, kw_only=True):
    """Path from a command to the propeller, for each thruster; the controller's model has none of it."""

    dead_time_s: Annotated[float, Meta(ge=0, le=10)] = 0.0
    dead_zone_N: Force = 0.0  # smaller commands move no propeller
    quantum_N: Force = 0.0  # commands are rounded to its multiples; 0: none


class Wind(_Table, frozen=True, kw_only=True):
    """Force of the wind on the vehicle at the surface, less than 0.5 m deep."""

    force_N: Force = 0.0
    direction_rad: Angle = 0.0  # towards which, from north
    gust_N: Force = 0.0  # rms of the changes of the force
    gust_period_s: Annotated[float, Meta(ge=1, le=1e4)] = 20.0


class Plant(_Table, frozen=True, kw_only=True):
    """Effects of the simulated vehicle that the controller's model does not have."""

    mismatch: Mismatch = Mismatch()
    actuators: Actuators = Actuators()
    wind: Wind = Wind()
    tilt_rms_rad: Annotated[float, Meta(ge=0, le=0.5)] = 0.026179938779914945  # 1.5 deg of roll and of pitch
    tilt_period_s: Annotated[float, Meta(ge=0.5, le=1000)] = 4.0
    north_m: Annotated[float, Meta(ge=-1e5, le=1e5)] = 0.0  # where it starts
    east_m: Annotated[float, Meta(ge=-1e5, le=1e5)] = 0.0
    depth_m: Annotated[float, Meta(ge=0, le=2000)] = 0.0
    heading_rad: Annotated[float, Meta(ge=-3.1416, le=3.1416)] = 0.0


class Run(_Table, frozen=True, kw_only=True):
    """Duration, speed and seed of the run."""

    duration_s: Annotated[float, Meta(gt=0, le=1e6)] = 200.0  # after the surface phase
    surface_time_s: Annotated[float, Meta(ge=1, le=1e5)] = 1.0  # 1: one TDCP fix
    seed: Annotated[int, Meta(ge=0, le=2**53 - 1)] = 0
    speed: Annotated[float, Meta(ge=0.01, le=1000)] = 10.0  # times real time; lock step does not read it
    compute_delay_s: Annotated[float, Meta(ge=0, le=60)] = 0.0  # added to the controller's own
    perfect_state: bool = False  # the controller is given the truth
    arm: bool = True  # the plant arms the controller; false: it waits, disarmed, for `ltv-mpc ctl arm`


class Scenario(_Table, frozen=True, kw_only=True):
    """Complete description of a simulated run."""

    title: str
    vehicle: str = "paper"  # NAME or FILE
    sensors: str = "paper"  # NAME or FILE
    reference: str = "descent"  # NAME or FILE
    fence: str = ""  # FILE; empty: none
    bathymetry: str = ""  # FILE that the controller has; empty: none. The sea bed of the simulation is [water] bottom_m
    run: Run = Run()
    water: Water = Water()
    plant: Plant = Plant()
    controller: ControllerConfig = ControllerConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    made_by: dict[str, str] | None = None  # in a run's folder: versions, commit, processor

    @classmethod
    def load(cls, name: str) -> Scenario:
        """Load a shipped scenario by name (``"descent"``, ``"hover"``) or a TOML file by path. Raises ``ConfigError``.

        Relative paths in a file are relative to that file's folder.
        """
        path = config.find(name, what="scenario", package="sim.scenarios")
        source = config.error_source(path, what="scenario", name=name)
        scenario = config.parse(config.read_toml(path, what="scenario"), cls, source=source)
        here = path.parent
        water = scenario.water
        return checked(
            msgspec.structs.replace(
                scenario,
                vehicle=_beside(here, scenario.vehicle),
                sensors=_beside(here, scenario.sensors),
                reference=_beside(here, scenario.reference),
                fence=str(here / scenario.fence) if scenario.fence else "",
                bathymetry=str(here / scenario.bathymetry) if scenario.bathymetry else "",
                water=msgspec.structs.replace(water, file=str(here / water.file) if water.file else ""),
            ),
            source=source,
        )

    @property
    def start_ns(self) -> int:
        """Vehicle time (ns) at which the run starts: afloat, before t = 0."""
        return -round(self.run.surface_time_s * 1e9)

    @property
    def end_ns(self) -> int:
        """Vehicle time (ns) at which the run is complete."""
        return round(self.run.duration_s * 1e9)


def checked(scenario: Scenario, *, source: str) -> Scenario:
    """Return the scenario after the checks that involve more than one field. Raises ``ConfigError``."""
    water, estimator = scenario.water, scenario.estimator
    if water.kind == "measured" and not water.file:
        raise ConfigError(source, "[water] file", 'must name a currents CSV where kind = "measured"', value="")
    if water.kind == "markov" and water.file:
        problem = 'is not read where kind = "markov": set kind = "measured", or file = ""'
        raise ConfigError(source, "[water] file", problem, value=water.file)
    if water.bottom_m is not None and water.bottom_m <= scenario.plant.depth_m:
        problem = f"must be deeper than the start of the vehicle, [plant] depth_m = {scenario.plant.depth_m:g}"
        raise ConfigError(source, "[water] bottom_m", problem, value=water.bottom_m)
    if water.feature.kind == "none" and water.feature != Feature():
        problem = 'must be "front", "step", "waves" or "tide" where another key of its table is set'
        raise ConfigError(source, "[water.feature] kind", problem, value="none")
    waves, plant = water.surface_waves, scenario.plant
    highest_m = STEEPEST * GRAVITY_MPS2 * waves.period_s**2 / (2.0 * math.pi)
    if waves.height_m > highest_m:
        problem = f"must be at most {highest_m:.3g}, a seventh of the wavelength: a steeper wave breaks"
        raise ConfigError(source, "[water.surface_waves] height_m", problem, value=waves.height_m)
    if plant.depth_m >= SURFACED_M and max(plant.wind.force_N, plant.wind.gust_N) > 0.0:
        problem = f"must be less than {SURFACED_M} where [plant.wind] has a force: deeper, no wind acts"
        raise ConfigError(source, "[plant] depth_m", problem, value=plant.depth_m)
    check_cells(water.deepest_m, water.cell_m, MAX_WATER_CELLS, source, "[water] cell_m")
    check_cells(estimator.deepest_m, estimator.cell_m, MAX_CELLS, source, "[estimator] cell_m")
    return scenario


def with_overrides(scenario: Scenario, assignments: Sequence[str], *, source: str = "option --set") -> Scenario:
    """Return the scenario with settings changed by ``["water.sd_mps=0.1", "vehicle=otter.toml", ...]``.

    Values are TOML values; a text needs no quotes. The caller calls ``checked`` afterwards. Raises ``ConfigError``;
    for an unknown key it names the most similar known one.
    """
    kinds = {key: kind for key, kind in settings_schema.scalar_fields(Scenario).items() if key != "made_by"}
    table = msgspec.to_builtins(scenario)
    for assignment in assignments:
        key, equals, text = (part.strip() for part in assignment.partition("="))
        if not equals:
            raise ConfigError(source, format_value(assignment), "must be KEY=VALUE, as in water.sd_mps=0.1")
        if key not in kinds:
            inside = [name for name in kinds if name.startswith(f"{key}.")]
            problem = f"is a table: set one of {', '.join(inside)}" if inside else f"unknown key{_near(key, kinds)}"
            raise ConfigError(source, format_value(key), problem)
        *outer, last = key.split(".")
        reduce(getitem, outer, table)[last] = _value(text, kinds[key], key, source)
    return config.parse(table, Scenario, source=source)


def _near(key: str, known: Iterable[str]) -> str:
    meant = settings_schema.closest_name(key, known)
    return f"; did you mean {format_value(meant)}?" if meant else "; the keys are those of a run's scenario.toml"


def _value(text: str, kind: settings_schema.Type, key: str, source: str) -> Any:
    """Parse a TOML value; a text needs no quotes."""
    try:
        table = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        table = {}
    value = table["value"] if len(table) == 1 else None
    if settings_schema.is_text(kind):
        return value if isinstance(value, str) else text
    if value is None:
        raise ConfigError(
            source, config.toml_key(key.split(".")), f"must be {settings_schema.expected(kind)}", value=text
        )
    return value


def _beside(folder: Path, name: str) -> str:
    """Return the path of a file named in a scenario file; the name of a shipped file stays as it is."""
    return str(folder / name) if config.is_path(name) else name
