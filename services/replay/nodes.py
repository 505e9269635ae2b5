"""Nodes of a run, rebuilt from the settings in its recording.

run.mcap contains every settings file of the run's folder, so a replay needs no other file. The processes and lock step
build their nodes from the same settings.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Mapping
from pathlib import Path

import msgspec

from ltv_mpc import config
from ltv_mpc.control import config as control
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.node import Node
from services.replay.verdict import Change
from services.run.nodes import make_nodes
from services.run.run_config import RunConfig, resolve
from services.run.water import load_prior, resolve_prior_path

SCENARIO = "scenario.toml"

SETTINGS: Mapping[str, type[msgspec.Struct]] = {
    ControllerNode.name: ControllerConfig,
    Estimator.name: EstimatorConfig,
}
"""Nodes whose settings another file may replace: RUN/config/<name>.toml."""


def run_config_of(metadata: Mapping[str, str], *, source: str) -> RunConfig:
    """Return the configuration of the run, from the recording's ``metadata``. Raises ``ConfigError``."""
    if SCENARIO not in metadata:
        raise ConfigError(
            source, "", f"does not hold the run's settings ({SCENARIO}): it is not a recording of this program"
        )
    with tempfile.TemporaryDirectory() as place:
        for name, text in metadata.items():
            path = Path(place, name)
            if name.endswith((".toml", ".csv")) and path.resolve().is_relative_to(Path(place).resolve()):
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
        try:
            return resolve(str(Path(place, SCENARIO)))
        except ConfigError as error:
            problem = f"its settings are rejected: {error.source.replace(f'{place}/', '')}"
            raise ConfigError(source, error.field, f"{problem}: {error.problem}", value=error.value) from None


def names(run_config: RunConfig) -> tuple[str, ...]:
    """Return the nodes that can be replayed, in the order of the process table."""
    return tuple(node.name for node in make_nodes(run_config))


def make(run_config: RunConfig, name: str) -> Node:
    """Build a new node, as at the start of its process."""
    return next(node for node in make_nodes(run_config) if node.name == name)


def settings_of(run_config: RunConfig, name: str) -> msgspec.Struct:
    """Return the settings of a node that may be replaced."""
    return run_config.scenario.controller if name == ControllerNode.name else run_config.scenario.estimator


def node_of(path: Path) -> str:
    """Return the node whose settings the file has, by its keys, which no two nodes share. Raises ``ConfigError``."""
    table = config.read_toml(path, what="settings")
    shared = {name: len(table.keys() & set(kind.__struct_fields__)) for name, kind in SETTINGS.items()}
    fits = [name for name, count in shared.items() if count == max(shared.values())]
    if len(fits) > 1:
        files = " or ".join(f"RUN/config/{name}.toml" for name in SETTINGS)
        raise ConfigError(f"--with {path}", "", f"must be a file like {files}: its keys fit none of them")
    return fits[0]


def replaced(run_config: RunConfig, path: Path) -> tuple[str, RunConfig, tuple[Change, ...]]:
    """Return the node whose settings the file has, the configuration with these settings, and the changes.

    A missing key has its default, as for ``--settings``. Raises ``ConfigError``.
    """
    name = node_of(path)
    scenario = run_config.scenario
    if name == ControllerNode.name:
        controller = control.validate(ControllerConfig.load(str(path)), source=f"--with {path}")
        other = dataclasses.replace(run_config, scenario=msgspec.structs.replace(scenario, controller=controller))
    else:
        estimator = resolve_prior_path(path.parent, EstimatorConfig.load(str(path)))
        changed = msgspec.structs.replace(scenario, estimator=estimator)
        other = dataclasses.replace(run_config, scenario=changed, prior=load_prior(estimator))
    if name not in names(other):
        raise ConfigError(f"--with {path}", "", f"the run has no {name}: it ran with run.perfect_state")
    return name, other, _changes(settings_of(run_config, name), settings_of(other, name))


def _changes(run: msgspec.Struct, here: msgspec.Struct) -> tuple[Change, ...]:
    was, is_ = _flat(msgspec.to_builtins(run)), _flat(msgspec.to_builtins(here))
    for table in (was, is_):  # a file's folder is not a setting
        table |= {key: Path(str(table[key])).name for key in ("water_prior",) if key in table}
    return tuple(
        Change(key=key, run=was.get(key), here=is_.get(key)) for key in {**was, **is_} if was.get(key) != is_.get(key)
    )


def _flat(table: Mapping[str, object], under: str = "") -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in table.items():
        flat |= _flat(value, f"{under}{key}.") if isinstance(value, Mapping) else {f"{under}{key}": value}
    return flat
