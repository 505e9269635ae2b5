"""Plan of a dive: expected drift over time, its error budget, and what would reduce it, from the Cramer-Rao bound.

The dive is simulated with its filter in the loop, several times, and the bound is computed along each true track.

drift    sigma(t) of one horizontal axis since submergence (m), the bound of ``sim/evaluation/cramer_rao_bound``, rms
         over the simulated dives
share    of source g in the variance at the end,  s_g = d ln sigma^2 / d ln sigma_g^2.  Measurements, biases and priors
         are linear and independent, so sigma^2 is homogeneous of degree 1 in their variances, and all s_g together
         are 1 (Euler)
gain     sigma at the end after one change of the dive or of its sensors, everything else as before
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from ltv_mpc import references
from ltv_mpc.frames import rotation
from ltv_mpc.localisation.config import MAX_CELLS, EstimatorConfig
from ltv_mpc.localisation.filter.state import grid
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import fitted
from ltv_mpc.messages import Message, Plan, Truth
from ltv_mpc.references import Hold, Point
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from services.tools.batch.executor import in_order
from sim.evaluation.cramer_rao_bound import Trajectory, bound

DESCENT_S = 200.0
"""Length of a dive without a given duration (s)."""

POINTS = 40
"""Number of instants of the drift over time."""

PATH_S = 3600.0
"""Longest simulated time of a path without a given duration (s)."""

TRACK_NS = 100_000_000
"""Period of the simulated track."""

STEP = 1.25
"""Factor by which a variance is raised and lowered to measure its share."""

LONGER_S, HOUR_S, TURN_S = 60.0, 3600.0, 60.0
"""Longer time afloat, time of a calibration, and time of a full turn at the start of the descent."""

GAINS = 5
"""Number of changes whose gain is computed."""

RADIUS_95 = math.sqrt(-2.0 * math.log(0.05))
"""Horizontal radius that holds 95 % of the ends, in sigma of one axis."""

SOURCES: dict[str, tuple[str, ...]] = {
    "satellite position and velocity": ("gnss.position_sd_m", "gnss.velocity_sd_mps"),
    "satellite displacement (TDCP)": ("tdcp.displacement_sd_m",),
    "ADCP noise": ("adcp.beam_noise_sd_mps",),
    "ADCP biases and mounting": ("adcp.beam_bias_sd_mps", "adcp.near_bias_sd_mps", "adcp.mounting_known_to_rad"),
    "gyro noise": ("imu.angle_random_walk_rad_per_rts",),
    "gyro bias": ("imu.gyro_bias_sd_radps",),
    "accelerometer noise": ("imu.velocity_random_walk_mps_per_rts",),
    "accelerometer bias": ("imu.accelerometer_bias_sd_mps2",),
    "heading (compass noise and bias)": ("compass.heading_sd_rad", "compass.bias_sd_rad"),
    "pressure": ("pressure.depth_sd_m",),
    "prior of the water": ("water.current_sd_mps", "water.current_mean_sd_mps", "water.current_change_mps_per_rts"),
    "levelling at the start": ("water.afloat_acceleration_sd_mps2",),
}
"""Sources of the error budget, and the settings that are their standard deviations; ``water`` is [estimator]."""


class RecordedDrift(msgspec.Struct, frozen=True, kw_only=True):
    """Drift of a recorded run over time."""

    t_s: list[float]
    drift_m: list[float]
    kind: str  # "true": estimate minus truth, rms of both axes; "reported": growth of the filter's sigma


class DivePlan(msgspec.Struct, frozen=True, kw_only=True):
    """Content of dive-plan.json. Drifts are standard deviations of one horizontal axis."""

    sensors: str
    reference: str
    runs: int  # simulated dives
    duration_s: float
    depth_m: float  # largest
    fixes: list[int]
    t_s: list[float]
    drift_m: list[list[float]]  # by number of fixes, over t_s
    radius_95_m: list[float]  # at the end
    limit_m: float | None
    limit_reached_s: list[float | None]  # None: not within the dive
    budget: dict[str, float]  # share of the variance at the end, with the first number of fixes
    gains_m: dict[str, float]  # drift at the end after each change, with the first number of fixes
    not_counted: list[str]  # sensors of the file that the bound does not include
    notes: list[str]  # what the vehicle cannot do of the reference
    against: RecordedDrift | None = None


class Case(NamedTuple):
    """One bound to compute: the arguments of ``bound``."""

    sensor_config: SensorConfig
    config: EstimatorConfig
    trajectory: Trajectory
    at_s: tuple[float, ...]
    surface_time_s: float
    calibration_s: float = 0.0


def drift(case: Case) -> list[float]:
    """Return the bound on the drift of one axis (m) at the instants of the case."""
    found: list[float] = bound(**case._asdict()).drift_rms_m.tolist()
    return found


class Dive(NamedTuple):
    """Simulated dive: sensors, reference (None: a vertical descent), and the time afloat before it as fixes."""

    sensors: str  # NAME or FILE
    reference: str | None  # NAME or FILE
    duration_s: float | None  # None: 200 s, and for a path the time at which it is complete
    depth_m: float  # at the end of a descent
    fixes: int
    seed: int

    def run_config(self) -> RunConfig:
        """Resolve the run. Raises ``ConfigError``."""
        length_s = self.duration_s or DESCENT_S
        settings = [f"sensors={self.sensors}", f"run.seed={self.seed}"]
        if self.reference is not None:
            settings.append(f"reference={self.reference}")
            if self.duration_s is None and not isinstance(references.load(self.reference), Hold | Point):
                length_s = PATH_S
        fix_s = _fix_s(SensorConfig.load(self.sensors))
        settings += [f"run.duration_s={length_s}", f"run.surface_time_s={self.fixes * fix_s}"]
        run_config = resolve("descent", [Override("dive plan", settings)])
        if self.reference is not None:
            return run_config
        descent = Hold(start_s=0.0, depth_m=self.depth_m, descent_rate_mps=self.depth_m / length_s)
        return dataclasses.replace(run_config, reference=descent)


class Flight(NamedTuple):
    """Track of a simulated dive, and the drift along it."""

    case: Case
    drift_m: list[float]  # at the instants of the case


def fly(dive: Dive) -> Flight:
    """Simulate the dive with its filter in the loop, and compute the drift along its track.

    Raises ``ConfigError``.
    """
    run_config = dive.run_config()
    scenario, truths, complete = run_config.scenario, list[Truth](), list[Plan]()

    def keep(message: Message) -> None:
        match message:
            case Truth() as truth if truth.t_ns % TRACK_NS == 0:
                truths.append(truth)
            case Plan(progress=float(progress)) as plan if progress >= 1.0:
                complete.append(plan)

    lockstep_run.simulate(run_config, keep=keep, stop=lambda: bool(complete) and dive.duration_s is None)
    position = np.array([truth.position_m for truth in truths])
    config = deep_enough(scenario.estimator, float(position[:, 2].max()), run_config.sensor_config.adcp.range_m)
    trajectory = Trajectory(
        t_s=np.array([truth.t_ns * 1e-9 for truth in truths]),
        position_m=position,
        velocity_mps=np.array([truth.velocity_mps for truth in truths]),
        rotation=np.array([rotation(*truth.attitude_rad) for truth in truths]),
        water_mps=run_config.water.over(grid(config), 0),
    )
    at_s = tuple(float(trajectory.t_s[-1]) * (k + 1) / POINTS for k in range(POINTS))
    case = Case(run_config.sensor_config, config, trajectory, at_s, scenario.run.surface_time_s)
    return Flight(case, drift(case))


def deep_enough(config: EstimatorConfig, depth_m: float, range_m: float) -> EstimatorConfig:
    """Return the settings of the filter with a depth grid as deep as the beams; a very deep one has larger cells."""
    deepest_m = max(config.deepest_m, float(math.ceil(depth_m + range_m)))
    return replace(config, deepest_m=deepest_m, cell_m=max(config.cell_m, deepest_m / MAX_CELLS))


def _fix_s(sensors: SensorConfig) -> float:
    return sensors.gnss.period_ns * 1e-9


def plan(
    dive: Dive, *, fixes: Sequence[int], runs: int, limit_m: float | None, progress: Callable[[float], None]
) -> DivePlan:
    """Simulate the dives and compute all bounds. Raises ``ConfigError``.

    Parameters
    ----------
    dive
        Dive to plan; its number of fixes is replaced by each of ``fixes``, and its seed is the first one.
    fixes
        Numbers of satellite fixes; budget and gains are those of the first.
    runs
        Number of simulated dives over which the variance of the drift is averaged.
    limit_m
        Drift whose time is wanted (m), or None.
    progress
        Receives the share done.
    """
    total, done = len(fixes) * runs + 2 * len(SOURCES) + GAINS, itertools.count(1)

    def advance(_: float) -> None:
        progress(next(done) / total)

    dives = [dive._replace(fixes=n, seed=dive.seed + i) for n in fixes for i in range(runs)]
    flights = in_order(fly, dives, progress=advance)
    drift_m = np.array([flight.drift_m for flight in flights]).reshape(len(fixes), runs, -1)
    lines = np.sqrt(np.mean(np.square(drift_m), axis=1)).tolist()
    first = flights[0]
    end_s, end_m = first.case.at_s[-1], lines[0][-1]
    base = first.case._replace(at_s=(end_s,))
    changes = gains(base)
    sources = [scaled(base, keys, factor) for keys in SOURCES.values() for factor in (STEP, 1.0 / STEP)]
    ends = [line[-1] for line in in_order(drift, [*changes.values(), *sources], progress=advance)]
    ratios, more, less = [end / first.drift_m[-1] for end in ends[:GAINS]], ends[GAINS::2], ends[GAINS + 1 :: 2]
    shares = {name: math.log(high / low) / math.log(STEP) for name, high, low in zip(SOURCES, more, less, strict=True)}
    run_config, sensors = dives[0].run_config(), first.case.sensor_config
    t_s = [float(t) for t in np.mean([flight.case.at_s for flight in flights], axis=0)]
    return DivePlan(
        sensors=sensors.name,
        reference=dive.reference or "descent",
        runs=runs,
        duration_s=t_s[-1],
        depth_m=float(first.case.trajectory.position_m[:, 2].max()),
        fixes=list(fixes),
        t_s=t_s,
        drift_m=lines,
        radius_95_m=[RADIUS_95 * line[-1] for line in lines],
        limit_m=limit_m,
        limit_reached_s=[None if limit_m is None else reached_s(t_s, line, limit_m) for line in lines],
        budget=dict(sorted(shares.items(), key=lambda item: -item[1])),
        gains_m={name: ratio * end_m for name, ratio in zip(changes, ratios, strict=True)},
        not_counted=not_counted(sensors),
        notes=list(run_config.reference.notes(run_config.vehicle)),
    )


def not_counted(sensors: SensorConfig) -> list[str]:
    """Return the names of the vehicle's sensors that are no source of the error budget."""
    counted = {key.partition(".")[0] for keys in SOURCES.values() for key in keys}
    return [sensor.name for sensor, _ in fitted(sensors) if sensor.name not in counted]


def gains(base: Case) -> dict[str, Case]:
    """Return the ``GAINS`` changes of the dive whose gain is computed."""
    return {
        "one more satellite fix": base._replace(surface_time_s=base.surface_time_s + _fix_s(base.sensor_config)),
        f"{LONGER_S:g} s longer afloat": base._replace(surface_time_s=base.surface_time_s + LONGER_S),
        f"a full turn in the first {TURN_S:g} s": base._replace(trajectory=turned(base.trajectory)),
        "half the ADCP noise": scaled(base, SOURCES["ADCP noise"], 0.25),
        "an hour of calibration before": base._replace(calibration_s=HOUR_S),
    }


def scaled(case: Case, keys: Sequence[str], factor: float) -> Case:
    """Return the case with the variances of the named settings multiplied by a factor."""
    tables: dict[str, Any] = {**msgspec.structs.asdict(case.sensor_config), "water": case.config}
    for table, field in (key.split(".") for key in keys):
        sd = getattr(tables[table], field) * math.sqrt(factor)
        tables[table] = replace(tables[table], **{field: sd})
    water = tables.pop("water")
    return case._replace(sensor_config=replace(case.sensor_config, **tables), config=water)


def turned(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory with a full turn about the vertical at the start of the descent."""
    angles = 2.0 * math.pi * np.clip(trajectory.t_s / TURN_S, 0.0, 1.0)
    turns = np.array([rotation(0.0, 0.0, angle) for angle in angles])
    return trajectory._replace(rotation=turns @ trajectory.rotation)


def reached_s(t_s: Sequence[float], drift_m: Sequence[float], limit_m: float) -> float | None:
    """Return the first time (s) at which the drift reaches a limit, linear between instants; None: it does not."""
    t, d = np.array([0.0, *t_s]), np.array([0.0, *drift_m])
    over = np.flatnonzero(d >= limit_m)
    if not len(over):
        return None
    i = max(int(over[0]), 1)
    return float(t[i - 1] + (t[i] - t[i - 1]) * (limit_m - d[i - 1]) / (d[i] - d[i - 1]))
