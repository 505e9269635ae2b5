"""Run configuration: all inputs of a run, read and checked before a process starts or a folder is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgspec

from ltv_mpc import config, references
from ltv_mpc.bathymetry import Bathymetry, bathymetry_for
from ltv_mpc.control import solvers
from ltv_mpc.control.config import STAGE_NS, ResolvedConfig
from ltv_mpc.control.resolution import settled
from ltv_mpc.currents import WaterPrior, read_profile
from ltv_mpc.geofence.fence import Fence, fence_for
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.references import Reference
from ltv_mpc.vehicle.parameters import Vehicle
from services.run.provenance import provenance_table
from services.run.settings_files import BATHYMETRY, FENCE, PRIOR, controller_files, estimator_files
from services.run.water import load_prior, resolve_prior_path
from sim import water
from sim.scenario import Scenario, checked, with_overrides

SCENARIO = "scenario.toml"
"""File of a run's folder with which it can be run again."""

ORIGIN = "scenario"
"""Entry of a run's [made_by] with the name of its scenario."""


class Override(NamedTuple):
    """Settings that one command-line option sets, and the name of the option in error messages."""

    source: str
    assignments: Sequence[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """Resolved inputs of a run."""

    name: str  # of the scenario: "descent"
    scenario: Scenario
    vehicle: Vehicle
    controller: ResolvedConfig  # settings of the scenario, with this vehicle's horizon and weights
    sensor_config: SensorConfig
    reference: Reference
    fence: Fence | None
    bathymetry: Bathymetry | None
    water: water.WaterColumn
    prior: WaterPrior | None  # water prior of the estimator; None: only the prior of the settings
    files: Mapping[str, str]  # texts by path in the run's folder, with which it can be run again
    notes: tuple[str, ...]  # remarks on the inputs for readers of the results


def resolve(name: str, overrides: Sequence[Override] = ()) -> RunConfig:
    """Return the configuration of a scenario (NAME or FILE) with overrides. Raises ``ConfigError``."""
    scenario = Scenario.load(name)
    folder = config.find(name, what="scenario", package="sim.scenarios").parent
    scenario = msgspec.structs.replace(scenario, estimator=resolve_prior_path(folder, scenario.estimator))
    for override in overrides:
        scenario = with_overrides(scenario, override.assignments, source=override.source)
    scenario = checked(scenario, source=f"scenario {name}")
    measured = Vehicle.load(scenario.vehicle)
    vehicle = measured.at_origin()  # the point of which the simulated navigation gives estimates
    sensor_config = SensorConfig.load(scenario.sensors)
    controller = settled(scenario.controller, vehicle, source=f"scenario {name}", table=("controller",))
    solvers.make(vehicle, controller)  # raises ConfigError if the solver is not installed
    notes: list[str] = []
    reference = references.load(scenario.reference, notes)
    fence = fence_for(vehicle, reference, scenario.fence, notes)
    prior = load_prior(scenario.estimator)
    called = _called(name, scenario)
    files = _files(msgspec.structs.replace(scenario, controller=controller), called)
    notes += [*_notes(scenario, controller, prior), *reference.notes(vehicle)]
    if vehicle != measured:
        files["config/vehicle.toml"] = config.to_toml(vehicle)
        notes.append("[reference_point] of the vehicle is not used: the simulated estimates are those of its origin")
    return RunConfig(
        name=called,
        scenario=scenario,
        vehicle=vehicle,
        controller=controller,
        sensor_config=sensor_config,
        reference=reference,
        fence=fence,
        bathymetry=bathymetry_for(reference, controller.limits, scenario.bathymetry),
        water=water.make(scenario.water, scenario.run.seed),
        prior=prior,
        files=files,
        notes=tuple(notes),
    )


def _called(name: str, scenario: Scenario) -> str:
    """Return the scenario's name: its file's, or for a run's own scenario.toml that of the run's original scenario."""
    origin = (scenario.made_by or {}).get(ORIGIN, "")
    plain = origin == Path(origin).name and origin.isprintable()  # it becomes part of a folder's name
    return origin if origin and plain else Path(name).stem if config.is_path(name) else name


def _files(scenario: Scenario, called: str) -> dict[str, str]:
    """Return the settings files as read, with comments; files for use aboard hold nothing of the true values."""
    measured = scenario.water.file
    files = controller_files(
        scenario.vehicle, scenario.reference, scenario.fence, scenario.bathymetry, scenario.controller
    )
    files |= estimator_files(scenario.sensors, scenario.estimator)
    if measured:
        files["config/currents.csv"] = config.read_text(Path(measured), what="currents")
    files[SCENARIO] = scenario_text(scenario, called)
    return files


def scenario_text(scenario: Scenario, called: str) -> str:
    """Return the text of a run's scenario.toml: the scenario with the files of its folder, and its provenance.

    Parameters
    ----------
    scenario : settings of the run.
    called : name of its scenario.
    """
    measured, prior = scenario.water.file, scenario.estimator.water_prior
    again = msgspec.structs.replace(
        scenario,
        vehicle="config/vehicle.toml",
        sensors="config/sensors.toml",
        reference="config/reference.toml",
        fence=FENCE if scenario.fence else "",
        bathymetry=BATHYMETRY if scenario.bathymetry else "",
        water=msgspec.structs.replace(scenario.water, file="config/currents.csv" if measured else ""),
        estimator=msgspec.structs.replace(scenario.estimator, water_prior=f"config/{PRIOR}" if prior else ""),
        made_by={ORIGIN: called, **provenance_table()},
    )
    return config.to_toml(again)


def _notes(scenario: Scenario, settings: ResolvedConfig, prior: WaterPrior | None) -> list[str]:
    before, end = settings.knots[-2:]
    growing = f", the last of {(end - before) * STAGE_NS / 1e9:.1f} s" if end - before > 1.0 else ""
    notes = [f"horizon {settings.reach_s:.3g} s in {settings.stages} stages{growing}"]
    if scenario.water.file:
        profile = read_profile(scenario.water.file, notes)
        first, last = float(profile.depth_m[0]), float(profile.depth_m[-1])
        name = Path(scenario.water.file).name
        notes.append(f"currents {name}: {first:g} to {last:g} m, held constant above and below")
    if prior is not None:
        first, last = float(prior.depth_m[0]), float(prior.depth_m[-1])
        name = Path(scenario.estimator.water_prior).name
        known = f"sd {1e3 * prior.sd_mps.min():.1f} to {1e3 * prior.sd_mps.max():.1f} mm/s"
        use = ", not used: run.perfect_state is set" if scenario.run.perfect_state else ""
        notes.append(f"water prior {name}: {first:g} to {last:g} m, {known}{use}")
    return notes
