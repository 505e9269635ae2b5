"""Settings files of the processes aboard: their texts, by their path in a run's folder.

A process aboard is built from these texts alone. A run's folder and its recording contain them. A process that is
started alone publishes its own as a ``NodeSettings`` message.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from ltv_mpc import config, references
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.messages import NodeSettings
from services.run.provenance import provenance_table

if TYPE_CHECKING:
    from ltv_mpc.localisation.config import EstimatorConfig

PRIOR = "water-prior.csv"
"""File of the estimator's water prior in a run's config/."""

MAX_CHARACTERS = 262_144
"""Largest size of the settings that a process publishes: it repeats them, and a frame is limited."""


TOO_LARGE = f"its settings have more than {MAX_CHARACTERS} characters: a recording of this process cannot be replayed"


FENCE = "config/fence.toml"
"""File of the fence in a run's folder, if there is one."""

BATHYMETRY = "config/bathymetry.csv"
"""File of the bathymetry in a run's folder, if there is one."""


def controller_files(
    vehicle: str, reference: str, fence: str, bathymetry: str, settings: ControllerConfig
) -> dict[str, str]:
    """Return the files of a controller. Raises ``ConfigError``.

    ``vehicle`` and ``reference`` are NAME or FILE, ``fence`` and ``bathymetry`` are a FILE or empty.
    """
    reference_text = _text(reference, what="reference", package="ltv_mpc.references.files")
    loaded_reference = references.load(reference)
    is_toml = not config.is_path(reference) or Path(reference).suffix.lower() == ".toml"
    if isinstance(loaded_reference, references.Timed) or not is_toml:
        reference_text = config.to_toml(loaded_reference)  # with the rows of the file that it names
    files = {
        "config/vehicle.toml": _text(vehicle, what="vehicle", package="ltv_mpc.vehicle.files"),
        "config/reference.toml": reference_text,
        "config/controller.toml": config.to_toml(settings),
    }
    if fence:
        files[FENCE] = config.to_toml(Fence.load(fence, None, loaded_reference.origin))
    if bathymetry:
        files[BATHYMETRY] = config.read_text(Path(bathymetry), what="bathymetry")
    return files


def estimator_files(sensors: str, settings: EstimatorConfig) -> dict[str, str]:
    """Return the files of an estimator; ``sensors`` is NAME or FILE. Raises ``ConfigError``.

    Sensors that extend a shipped file are resolved, because the shipped file may differ when the run is repeated.
    """
    sensors_text = _text(sensors, what="sensors", package="ltv_mpc.localisation.files")
    if "base" in config.loads(sensors_text):
        from ltv_mpc.localisation.sensor_config import SensorConfig  # a controller does not load the estimator

        sensors_text = config.to_toml(SensorConfig.load(sensors))
    files = {"config/sensors.toml": sensors_text}
    prior = settings.water_prior
    if prior:
        files[f"config/{PRIOR}"] = config.read_text(Path(prior), what="currents")
    # The file names the prior relative to its own folder.
    files["config/estimator.toml"] = config.to_toml(
        msgspec.structs.replace(settings, water_prior=PRIOR if prior else "")
    )
    return files


def node_settings(node: str, files: Mapping[str, str]) -> NodeSettings | None:
    """Return the message with the settings of a process; None if they are too large to be published."""
    if sum(map(len, files.values())) > MAX_CHARACTERS:
        return None
    return NodeSettings(node=node, files=dict(files), made_by=provenance_table())


def _text(name: str, *, what: str, package: str) -> str:
    return config.read_text(config.find(name, what=what, package=package), what=what)
