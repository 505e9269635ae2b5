"""Nodes of a recorded run, rebuilt from the settings in its recording.

A recording of a simulation holds every settings file of the run's folder in its metadata. A recording beside a vehicle
holds the same files of controller and estimator, as these published them at each of their starts.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import msgspec

from ltv_mpc import config, references
from ltv_mpc.bathymetry import bathymetry_for
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.resolution import settled
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import fence_for
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import NodeSettings
from ltv_mpc.node import Node
from ltv_mpc.settings_schema import flat
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.topics import BY_TYPE
from services.bus.wire import WireError
from services.recording.node_settings import vehicle_name
from services.recording.reader import Recording, metadata_of
from services.recording.recover import segments
from services.replay.verdict import Change
from services.run.folder import write_files
from services.run.nodes import make_nodes
from services.run.run_config import SCENARIO, RunConfig, resolve
from services.run.settings_files import BATHYMETRY
from services.run.water import load_prior, resolve_prior_path
from sim.plant import Plant
from sim.sensors.node import Sensors

SETTINGS: Mapping[str, type[ControllerConfig] | type[EstimatorConfig]] = {
    ControllerNode.name: ControllerConfig,
    Estimator.name: EstimatorConfig,
}
"""Nodes aboard, whose settings another file may replace: RUN/config/<name>.toml."""

PREFIX = f"{BY_TYPE[NodeSettings].key}/"

EVERY_START = 0
"""In place of an epoch, which is never 0: the settings of a simulation are the same at each start."""


class NoSettingsError(LookupError):
    """The recording does not hold the settings of this start of a node."""


class Run:
    """Recording of a run, and its nodes that can be replayed: those aboard from their settings files, by their starts.

    Raises ``ConfigError`` if it has no valid settings of any node.
    """

    def __init__(self, path: Path) -> None:
        self.path, self._source = path, f"recording {path}"
        self.metadata = metadata_of(path)
        self._world = run_config_of(self.metadata, source=self._source) if SCENARIO in self.metadata else None
        self._settings: dict[str, dict[int, NodeSettings]] = {}  # by node and epoch, those of the newest start last
        if self._world is not None:
            scenario = self._world.scenario
            aboard = [ControllerNode.name] if scenario.run.perfect_state else [Estimator.name, ControllerNode.name]
            files, made_by = dict(self.metadata), scenario.made_by or {}
            self._settings = {
                name: {EVERY_START: NodeSettings(node=name, files=files, made_by=made_by)} for name in aboard
            }
            return
        self._read_published()
        if not self._settings.keys() & SETTINGS.keys():
            problem = (
                f"has no settings to build a node from: neither those of a simulation ({SCENARIO}) nor those that a "
                "controller or an estimator beside the recorder publishes"
            )
            raise ConfigError(self._source, "", problem)

    def recording(self) -> Recording:
        """Return the file and the segments that restarted recorders have left beside it."""
        return Recording(*segments(self.path))

    def _read_published(self) -> None:
        """Read the settings that the processes published. Invalid messages are skipped."""
        for stored in self.recording():
            if stored.kind is NodeSettings:
                with contextlib.suppress(WireError):
                    message, header = stored.typed()
                    assert isinstance(message, NodeSettings)
                    self._settings.setdefault(stored.key.removeprefix(PREFIX), {})[header.epoch] = message

    @property
    def title(self) -> str:
        """Name of the scenario, or of the vehicle, from the controller's file."""
        if self._world is not None:
            return self._world.name
        name = ControllerNode.name
        return vehicle_name(self._of(name, None).files) if name in self.names else "vehicle"

    @property
    def made_by(self) -> Mapping[str, str]:
        """Provenance of the newest start."""
        return self._of(self.names[-1], None).made_by

    @property
    def names(self) -> tuple[str, ...]:
        """Nodes that can be replayed, in the order of the process table."""
        aboard = tuple(name for name in (Estimator.name, ControllerNode.name) if name in self._settings)
        return aboard if self._world is None else (Plant.name, Sensors.name, *aboard)

    def only(self, node: str | None) -> tuple[str, ...]:
        """Return the node ``node``, or all for None. Raises ``ConfigError`` if the run does not have it."""
        if node is None:
            return self.names
        if node not in self.names:
            raise ConfigError("option --node", "", f"must be one of {', '.join(self.names)}", value=node)
        return (node,)

    def make(self, name: str, epoch: int | None = None, *, settings: Path | None = None) -> Node:
        """Build a new node, as at the start of its process; ``epoch``: the start, None: any.

        ``settings``: the file in place of its own, at all of its starts; None: its own.

        Raises ``NoSettingsError``, and ``ConfigError`` if the settings are rejected.
        """
        world = self._world
        if world is not None and name not in self._settings:
            return next(node for node in make_nodes(world) if node.name == name)
        with _unpacked(self._of(name, epoch).files, source=self._source) as place:
            folder = place / "config"
            chosen = _settings_in(name, folder, settings)
            if isinstance(chosen, EstimatorConfig):
                return Estimator(SensorConfig.load(str(folder / "sensors.toml")), chosen, load_prior(chosen))
            vehicle, fence = Vehicle.load(str(folder / "vehicle.toml")), folder / "fence.toml"
            reference, soundings = references.load(str(folder / "reference.toml")), place / BATHYMETRY
            kept = fence_for(vehicle, reference, str(fence) if fence.exists() else "")
            bottom = bathymetry_for(reference, chosen.limits, str(soundings) if soundings.exists() else "")
            node = ControllerNode(vehicle, reference, chosen, fence=kept)
            if bottom is not None:
                node.controller.set_bathymetry(bottom)
            return node

    def changes(self, name: str, path: Path) -> tuple[Change, ...]:
        """Return the changes that the settings in ``path`` make at the newest start of a node.

        A missing key has its default, as for ``--settings``. Raises ``ConfigError``.
        """
        if name not in self.names:
            raise ConfigError(f"--with {path}", "", f"the recording has no {name} that can be replayed")
        with _unpacked(self._of(name, None).files, source=self._source) as place:
            run, here = (_settings_in(name, place / "config", file) for file in (None, path))
        was, is_ = flat(msgspec.to_builtins(run)), flat(msgspec.to_builtins(here))
        for table in (was, is_):  # a file's folder is not a setting
            table |= {key: Path(str(table[key])).name for key in ("water_prior",) if key in table}
        return tuple(
            Change(key=key, run=was.get(key), here=is_.get(key))
            for key in {**was, **is_}
            if was.get(key) != is_.get(key)
        )

    def _of(self, name: str, epoch: int | None) -> NodeSettings:
        starts = self._settings[name]
        newest = next(reversed(starts.values()))
        found = newest if epoch is None else starts.get(epoch, starts.get(EVERY_START))
        if found is None:
            raise NoSettingsError(f"the settings of this {name} are not in the file")
        return found


def run_config_of(metadata: Mapping[str, str], *, source: str) -> RunConfig:
    """Return the configuration of a simulation, from the recording's ``metadata``. Raises ``ConfigError``."""
    with _unpacked(metadata, source=source) as place:
        return resolve(str(place / SCENARIO))


def node_of(path: Path) -> str:
    """Return the node whose settings the file has, by its keys, which no two nodes share. Raises ``ConfigError``."""
    table = config.read_toml(path, what="settings")
    shared = {name: len(table.keys() & set(kind.__struct_fields__)) for name, kind in SETTINGS.items()}
    fits = [name for name, count in shared.items() if count == max(shared.values())]
    if len(fits) > 1:
        files = " or ".join(f"RUN/config/{name}.toml" for name in SETTINGS)
        raise ConfigError(f"--with {path}", "", f"must be a file like {files}: its keys fit none of them")
    return fits[0]


def _settings_in(name: str, folder: Path, replacing: Path | None) -> ControllerConfig | EstimatorConfig:
    """Return the settings of a node from the files of its start in ``folder``, or from the file in their place.

    A water prior is named relative to the folder of the file.
    """
    path = replacing or folder / f"{name}.toml"
    if name == Estimator.name:
        return resolve_prior_path(path.parent, EstimatorConfig.load(str(path)))
    settings, vehicle = ControllerConfig.load(str(path)), Vehicle.load(str(folder / "vehicle.toml"))
    return settled(settings, vehicle, source=f"controller settings {path}")


@contextlib.contextmanager
def _unpacked(files: Mapping[str, str], *, source: str) -> Iterator[Path]:
    """Write settings files into a temporary folder. A ``ConfigError`` of one of them names the recording."""
    with tempfile.TemporaryDirectory() as place:
        root = Path(place).resolve()
        inside = (name for name in files if (root / name).resolve().is_relative_to(root))
        write_files(root, {name: files[name] for name in inside if name.endswith((".toml", ".csv"))})
        try:
            yield Path(place)
        except ConfigError as error:
            if place not in error.source:
                raise
            problem = f"its settings are rejected: {error.source.replace(f'{place}/', '')}"
            raise ConfigError(source, error.field, f"{problem}: {error.problem}", value=error.value) from None
