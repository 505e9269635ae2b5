"""Trial of a campaign: one run, on any worker, and its row of results.

A worker may be on another host, so a trial brings the base with it: the texts of a run's own settings files, which each
worker writes into a folder once.
"""

from __future__ import annotations

import atexit
import platform
import shutil
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import msgspec

import services
from ltv_mpc import config
from ltv_mpc.control import solvers
from ltv_mpc.control.resolution import settled
from ltv_mpc.errors import ConfigError, one_line
from ltv_mpc.messages import PlanOrigin, SolveStatus
from ltv_mpc.references import Reference
from ltv_mpc.settings_schema import flat
from ltv_mpc.vehicle.parameters import Vehicle
from services.run.folder import write_files
from services.run.provenance import provenance_table
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from services.tools.campaign.file import REFERENCE, VEHICLE, Campaign, Point, Value, metrics

Base: TypeAlias = tuple[tuple[str, str], ...]
"""Files of a run's folder, as (path, text), from ``RunConfig.files``."""

Row: TypeAlias = dict[str, Any]

COUNTS = (
    *(f"qp_status.{status.value}" for status in SolveStatus),
    *(f"plan_origin.{origin.value}" for origin in PlanOrigin),
)
"""Counts by name of summary.json; each is a column, with 0 if the name is missing."""

TIMING = ("host", "ended", "wall_s")
"""Columns of measured times, which go into a file of their own."""


class Trial(NamedTuple):
    """One point of the design with one seed."""

    number: int  # of the point
    seed: int
    point: Point

    @property
    def key(self) -> str:
        """Return the unique name of the trial within the campaign."""
        return f"point {self.number}, seed {self.seed}"


def run(base: Base, campaign: Campaign, version: str, trial: Trial) -> Row:
    """Make the run and return its row; if the run fails, ``failed`` has the reason."""
    ours = version_of(provenance_table())
    if ours != version:
        raise RuntimeError(f"this worker has version {ours}, the campaign {version}")
    if not services.ONE_BLAS_THREAD:
        names = "OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1"
        raise RuntimeError(
            f"BLAS of this worker may use several threads, which changes the last bits: start it with {names}"
        )
    started = time.perf_counter()
    try:
        summary = lockstep_run.run(run_config(base, campaign, trial))
    except Exception as error:  # one failed run does not end the campaign; its row gives the reason
        problem = str(error) if isinstance(error, ConfigError) else f"{type(error).__name__}: {error}"
        return row_of(trial, version, one_line(problem)[:500])
    found = flat(msgspec.to_builtins(summary))
    result = {key: found.get(key) for key in metrics()} | {key: found.get(key, 0) for key in COUNTS}
    return row_of(trial, version) | result | {"wall_s": time.perf_counter() - started}


def row_of(trial: Trial, version: str, failed: str = "") -> Row:
    """Return a row without metrics."""
    timing = {"host": platform.node(), "ended": datetime.now(UTC).isoformat(timespec="milliseconds")}
    who = {"point": trial.number, "seed": trial.seed, "version": version, "failed": failed or None}
    return {**who, **trial.point, **timing}


def version_of(table: Mapping[str, str]) -> str:
    """Return the version and commit that made a row."""
    return f"{table['ltv_mpc']} {table['commit']}"


def run_config(base: Base, campaign: Campaign, trial: Trial) -> RunConfig:
    """Resolve the settings of a trial's run. Raises ``ConfigError``."""
    settings = campaign.point_settings(trial.point)
    plain = _with_settings(base, settings, trial.seed)
    if not (factors := campaign.factors(trial.point)):
        return plain
    tables = {VEHICLE: plain.vehicle, REFERENCE: plain.reference, "controller": plain.controller}
    values = flat(msgspec.to_builtins(plain.scenario) | msgspec.to_builtins(tables))
    scaled = dict(settings)
    for key, factor in factors.items():
        if values.get(key) is None:
            raise ConfigError("campaign", key, "has no base value to scale")
        scaled[key] = float(values[key]) * factor
    return _with_settings(base, scaled, trial.seed)


def _with_settings(base: Base, settings: Mapping[str, Value], seed: int) -> RunConfig:
    own = [
        f"{key}={str(value).lower() if isinstance(value, bool) else value}"
        for key, value in settings.items()
        if not key.startswith((f"{VEHICLE}.", f"{REFERENCE}."))
    ]
    here = resolve(str(_folder(base) / "scenario.toml"), [Override("campaign", [*own, f"run.seed={seed}"])])
    if of_vehicle := _of(VEHICLE, settings):
        vehicle = _with_values(here.vehicle, Vehicle, of_vehicle, VEHICLE)
        here = replace(here, vehicle=vehicle, controller=settled(here.scenario.controller, vehicle, source="campaign"))
        solvers.make(here.vehicle, here.controller)
    if of_reference := _of(REFERENCE, settings):
        here = replace(here, reference=_with_values(here.reference, Reference, of_reference, REFERENCE))
    return here


def _of(owner: str, settings: Mapping[str, Value]) -> dict[str, Value]:
    """Select the settings of ``vehicle`` or ``reference``, by the key within its file."""
    return {key.removeprefix(f"{owner}."): value for key, value in settings.items() if key.startswith(f"{owner}.")}


def _with_values(struct: Any, kind: Any, values: Mapping[str, Value], owner: str) -> Any:
    """Return ``struct``, of type ``kind``, with the values at dotted keys replaced. Raises ``ConfigError``."""
    table = msgspec.to_builtins(struct)
    for key, value in values.items():
        *outer, last = key.split(".")
        inner = table
        for name in outer:
            if inner.get(name) is None:
                raise ConfigError("campaign", f"{owner}.{key}", f"the scenario's {owner} has no such table")
            inner = inner[name]
        inner[last] = value
    return config.parse({k: v for k, v in table.items() if v is not None}, kind, source=f"campaign: {owner}")


@lru_cache(maxsize=4)
def _folder(base: Base) -> Path:
    """Write the base's files into a temporary folder, which exists until this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="ltv-mpc-campaign-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    write_files(folder, dict(base))
    return folder
